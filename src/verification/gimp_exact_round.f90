!> Exact solutions in polar coordinates about `center`: generalised vortex and expanding ring (in 3D: about the z axis).
!>
!> Every procedure works on the `lanes` points of one chunk; arguments as in gimp_exact_flat.
module gimp_exact_round
  use gimp_kinds, only: dp, lanes
  use gimp_verification_types, only: verification_t, set_at_rest
  implicit none(type, external)
  private
  public :: vortex_motion, vortex_force, ring_motion, ring_force, set_ring_polynomial

contains

  !> x = Q(alpha) X with alpha = A sin(pi t/T) h(R) [Kamojjala, Brannon, Sadeghirad & Guilkey 2015].
  !>
  !> h = (1 - s^2)^2, s = (R - Rm)/w between the faces Rm -+ w, 0 elsewhere; for the radii 0.75 and 1.25 this is the
  !> published 1 - 32 q^2 + 256 q^4, q = R - 1. J = 1; the faces are free of traction and at rest.
  pure subroutine vortex_motion(v, t, x, u, vel, f)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: u(lanes, 3), vel(lanes, 3), f(lanes, 9)
    integer :: p
    real(dp) :: g, g_t, g_tt, h, h1, h2, r, e(2), c, s, y(2), twist, er(2), et(2)
    call set_at_rest(u, vel, f)
    call vortex_in_time(v, t, g, g_t, g_tt)
    do p = 1, lanes
      call polar(v, x(p, 1), x(p, 2), r, e)
      call vortex_profile(v, r, h, h1, h2)
      c = cos(g*h)
      s = sin(g*h)
      er = [c*e(1) - s*e(2), s*e(1) + c*e(2)] ! radial direction where the point is now
      et = [-er(2), er(1)]
      y = r*er
      u(p, 1:2) = y - r*e
      vel(p, 1) = -g_t*h*y(2)
      vel(p, 2) = g_t*h*y(1)
      twist = r*g*h1 ! F = Q (I + twist e_theta (x) e_r)
      f(p, 1) = c + twist*et(1)*e(1)
      f(p, 2) = -s + twist*et(1)*e(2)
      f(p, 4) = s + twist*et(2)*e(1)
      f(p, 5) = c + twist*et(2)*e(2)
    end do
  end subroutine vortex_motion

  !> Body force of the vortex: b_r = (mu/rho0) R (g h')^2 - R (g_t h)^2, b_t = R g_tt h - (mu/rho0) g (3 h' + R h''), in the
  !> polar axes where the point is now
  pure subroutine vortex_force(v, t, x, b)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: b(lanes, 3) !! [m/s2]
    integer :: p
    real(dp) :: g, g_t, g_tt, h, h1, h2, r, e(2), c, s, er(2), radial, around
    b = 0.0_dp
    call vortex_in_time(v, t, g, g_t, g_tt)
    do p = 1, lanes
      call polar(v, x(p, 1), x(p, 2), r, e)
      call vortex_profile(v, r, h, h1, h2)
      c = cos(g*h)
      s = sin(g*h)
      er = [c*e(1) - s*e(2), s*e(1) + c*e(2)]
      radial = v%mu/v%density*r*(g*h1)**2 - r*(g_t*h)**2
      around = r*g_tt*h - v%mu/v%density*g*(3.0_dp*h1 + r*h2)
      b(p, 1) = radial*er(1) - around*er(2)
      b(p, 2) = radial*er(2) + around*er(1)
    end do
  end subroutine vortex_force

  !> g = A sin(pi t/T) and its derivatives in time
  pure subroutine vortex_in_time(v, t, g, g_t, g_tt)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t
    real(dp), intent(out) :: g, g_t, g_tt
    g = v%amplitude*sin(v%omega*t)
    g_t = v%amplitude*v%omega*cos(v%omega*t)
    g_tt = -v%omega**2*g
  end subroutine vortex_in_time

  !> h(R) and its first two derivatives
  pure subroutine vortex_profile(v, r, h, h1, h2)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: r
    real(dp), intent(out) :: h, h1, h2
    real(dp) :: s, w
    w = 0.5_dp*(v%outer_radius - v%inner_radius)
    s = (r - 0.5_dp*(v%outer_radius + v%inner_radius))/w
    h = 0.0_dp
    h1 = 0.0_dp
    h2 = 0.0_dp
    if (abs(s) > 1.0_dp) return
    h = (1.0_dp - s*s)**2
    h1 = -4.0_dp*s*(1.0_dp - s*s)/w
    h2 = (12.0_dp*s*s - 4.0_dp)/w**2
  end subroutine vortex_profile

  !> u_R = A sin(w t)(c1 R + c2 R^2 + c3 R^3), w = pi c/(Ri + Ro) [Wallstedt & Guilkey 2008].
  !>
  !> du_R/dR vanishes on both faces, which for nu = 0 makes them free of traction; u_R(Ro) = A sin wt.
  pure subroutine ring_motion(v, t, x, u, vel, f)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: u(lanes, 3), vel(lanes, 3), f(lanes, 9)
    integer :: p
    real(dp) :: r, e(2), s(3), in_time, rate, fr, ft
    call set_at_rest(u, vel, f)
    in_time = v%amplitude*sin(v%omega*t)
    rate = v%amplitude*v%omega*cos(v%omega*t)
    do p = 1, lanes
      call polar(v, x(p, 1), x(p, 2), r, e)
      call ring_profile(v, r, s)
      u(p, 1:2) = in_time*s(1)*e
      vel(p, 1:2) = rate*s(1)*e
      fr = 1.0_dp + in_time*s(2)
      ft = 1.0_dp + in_time*s(1)/r
      f(p, 1) = fr*e(1)**2 + ft*e(2)**2
      f(p, 2) = (fr - ft)*e(1)*e(2)
      f(p, 4) = f(p, 2)
      f(p, 5) = fr*e(2)**2 + ft*e(1)**2
    end do
  end subroutine ring_motion

  !> Body force of the ring: b_R = u_tt - [P_r' + (P_r - P_t)/R]/rho0 with P_k = lambda ln J/F_k + mu (F_k - 1/F_k),
  !> F_r = 1 + u', F_t = 1 + u/R
  pure subroutine ring_force(v, t, x, b)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: b(lanes, 3) !! [m/s2]
    integer :: p
    real(dp) :: r, e(2), s(3), in_time, fr, ft, fr1, ft1, log_j, pr, pt, pr1
    b = 0.0_dp
    in_time = v%amplitude*sin(v%omega*t)
    do p = 1, lanes
      call polar(v, x(p, 1), x(p, 2), r, e)
      call ring_profile(v, r, s)
      s = in_time*s
      fr = 1.0_dp + s(2)
      ft = 1.0_dp + s(1)/r
      fr1 = s(3)
      ft1 = (s(2) - s(1)/r)/r
      log_j = log(fr*ft)
      pr = v%lambda*log_j/fr + v%mu*(fr - 1.0_dp/fr)
      pt = v%lambda*log_j/ft + v%mu*(ft - 1.0_dp/ft)
      pr1 = v%lambda*((fr1/fr + ft1/ft)/fr - log_j*fr1/fr**2) + v%mu*fr1*(1.0_dp + 1.0_dp/fr**2)
      b(p, 1:2) = (-v%omega**2*s(1) - (pr1 + (pr - pt)/r)/v%density)*e
    end do
  end subroutine ring_force

  !> u_R/(A sin wt) at R with its first two derivatives
  pure subroutine ring_profile(v, r, s)
    type(verification_t), intent(in) :: v
    real(dp), intent(inout) :: r !! taken to the nearest face where it lies off the ring: nothing is exact there
    real(dp), intent(out) :: s(3)
    r = min(max(r, v%inner_radius), v%outer_radius)
    s(1) = r*(v%ring_c1 + r*(v%ring_c2 + r*v%ring_c3))
    s(2) = v%ring_c1 + r*(2.0_dp*v%ring_c2 + r*3.0_dp*v%ring_c3)
    s(3) = 2.0_dp*v%ring_c2 + r*6.0_dp*v%ring_c3
  end subroutine ring_profile

  !> c1, c2, c3 from the radii; the radii must not be as 1 to 3
  pure subroutine set_ring_polynomial(v)
    type(verification_t), intent(inout) :: v
    real(dp) :: d, ri, ro
    ri = v%inner_radius
    ro = v%outer_radius
    d = ro**2*(ro - 3.0_dp*ri)
    v%ring_c1 = -6.0_dp*ri*ro/d
    v%ring_c2 = 3.0_dp*(ro + ri)/d
    v%ring_c3 = -2.0_dp/d
  end subroutine set_ring_polynomial

  !> Distance from the centre and the direction of the point; the x direction at the centre itself
  pure subroutine polar(v, x1, x2, r, e)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: x1, x2
    real(dp), intent(out) :: r, e(2)
    real(dp) :: d(2)
    d = [x1, x2] - v%center(1:2)
    r = sqrt(d(1)**2 + d(2)**2)
    e = [1.0_dp, 0.0_dp]
    if (r > 0.0_dp) e = d/r
  end subroutine polar

end module gimp_exact_round
