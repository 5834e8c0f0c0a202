!> Exact solutions in Cartesian coordinates: vibrating bar, axis-aligned vibration, column under its own weight, rigid motions.
!>
!> Every procedure works on the `lanes` points of one chunk. `x` is the reference position X [m], `u` the displacement [m],
!> `vel` the velocity [m/s], `f` the deformation gradient row by row. Components beyond the dimension are those of a body
!> that does not move there.
module gimp_exact_flat
  use gimp_kinds, only: dp, lanes, pi
  use gimp_verification_types, only: verification_t, set_at_rest, law_neo_hookean, law_hencky
  implicit none(type, external)
  private
  public :: bar_motion, axis_aligned_motion, axis_aligned_force, column_motion, translation_motion, rotation_motion
  public :: lambert_w

contains

  !> Bar fixed at 0, free at L, started with v0 sin(b X) [Bardenhagen 2002]: u = (v0/w) sin bX sin wt, b = pi/2L, w = b c.
  !>
  !> Exact for small strain: the nonlinear laws differ from it by terms of second order in v0/c.
  pure subroutine bar_motion(v, t, x, u, vel, f)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: u(lanes, 3), vel(lanes, 3), f(lanes, 9)
    integer :: p
    real(dp) :: in_time, rate, y
    call set_at_rest(u, vel, f)
    in_time = v%speed/v%omega*sin(v%omega*t)
    rate = v%speed*cos(v%omega*t)
    do p = 1, lanes
      y = v%wave_number*(x(p, 1) - v%center(1))
      u(p, 1) = in_time*sin(y)
      vel(p, 1) = rate*sin(y)
      f(p, 1) = 1.0_dp + in_time*v%wave_number*cos(y)
    end do
  end subroutine bar_motion

  !> u_k = A sin(pi X_k) sin(c pi t + phi_k), rollers on the walls of the unit cube [Wallstedt & Guilkey 2008]
  pure subroutine axis_aligned_motion(v, t, x, u, vel, f)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: u(lanes, 3), vel(lanes, 3), f(lanes, 9)
    integer :: p, k
    real(dp) :: in_time, rate, y
    call set_at_rest(u, vel, f)
    do k = 1, v%dim
      in_time = v%amplitude*sin(v%omega*t + v%phases(k))
      rate = v%amplitude*v%omega*cos(v%omega*t + v%phases(k))
      do p = 1, lanes
        y = pi*(x(p, k) - v%center(k))
        u(p, k) = in_time*sin(y)
        vel(p, k) = rate*sin(y)
        f(p, 4*k - 3) = 1.0_dp + in_time*pi*cos(y)
      end do
    end do
  end subroutine axis_aligned_motion

  !> Body force per mass of the axis-aligned vibration, neo-Hookean.
  !>
  !> F is diagonal and f_k depends on X_k alone, f_k' = -pi^2 u_k. With P_k = lambda K/f_k + mu (f_k - 1/f_k),
  !> K = ln prod f: P_k' = -pi^2 u_k [(lambda (1 - K) + mu)/f_k^2 + mu], and rho0 a_k = -E pi^2 u_k since c^2 = E/rho0. Hence
  !> b_k = (pi^2 u_k/rho0) [(lambda (1 - K) + mu)/f_k^2 + mu - E] in one, two and three dimensions alike.
  pure subroutine axis_aligned_force(v, t, x, b)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: b(lanes, 3) !! [m/s2]
    integer :: p, k
    real(dp) :: in_time(3), y, u(3), stretch(3), log_j
    b = 0.0_dp
    in_time = v%amplitude*sin(v%omega*t + v%phases)
    do p = 1, lanes
      log_j = 1.0_dp
      do k = 1, v%dim
        y = pi*(x(p, k) - v%center(k))
        u(k) = in_time(k)*sin(y)
        stretch(k) = 1.0_dp + in_time(k)*pi*cos(y)
        log_j = log_j*stretch(k)
      end do
      log_j = log(log_j)
      do k = 1, v%dim
        b(p, k) = pi**2*u(k)/v%density &
          *((v%lambda*(1.0_dp - log_j) + v%mu)/stretch(k)**2 + v%mu - v%young)
      end do
    end do
  end subroutine axis_aligned_force

  !> Column at rest under its own weight, nu = 0, standing on the wall of lower coordinate of the last axis.
  !>
  !> The nominal stress is P(Y) = -rho0 g (l0 - Y) for any law; with q = P/E the stretch l and the place y of a point are
  !> - neo-Hookean, P = (E/2)(l - 1/l): l = q + sqrt(1 + q^2), y = E/(rho0 g) [q^2/2 + (q sqrt(1 + q^2) + asinh q)/2];
  !> - Hencky, E ln(l)/l = P: l = exp(-W(-q)) with Lambert's W; with w = ln l: y = E/(rho0 g) [w - w^2/2];
  !> - rate law sigma' = C:D, E ln l = P: l = exp(q), y = E/(rho0 g) exp(q);
  !> each bracket taken between the base q(0) and q(Y).
  pure subroutine column_motion(v, x, u, vel, f)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: x(lanes, 3)
    real(dp), intent(out) :: u(lanes, 3), vel(lanes, 3), f(lanes, 9)
    integer :: p, k
    real(dp) :: load, height, q, place, base, stretch, unused
    call set_at_rest(u, vel, f)
    k = v%dim
    load = v%density*v%gravity/v%young ! 1/m
    call column_point(v%law, -load*v%length, base, unused)
    do p = 1, lanes
      height = x(p, k) - v%center(k)
      q = -load*max(v%length - height, 0.0_dp) ! a point above the top moves with it
      call column_point(v%law, q, place, stretch)
      u(p, k) = (place - base)/load - min(height, v%length)
      f(p, 4*k - 3) = stretch
    end do
  end subroutine column_motion

  !> Integral of the stretch over q, and the stretch, at q = P/E
  pure subroutine column_point(law, q, place, stretch)
    integer, intent(in) :: law
    real(dp), intent(in) :: q
    real(dp), intent(out) :: place, stretch
    real(dp) :: w
    select case (law)
    case (law_neo_hookean)
      stretch = q + sqrt(1.0_dp + q*q)
      place = 0.5_dp*(q*q + q*sqrt(1.0_dp + q*q) + asinh(q))
    case (law_hencky)
      w = -lambert_w(-q)
      stretch = exp(w)
      place = w - 0.5_dp*w*w
    case default
      stretch = exp(q)
      place = stretch
    end select
  end subroutine column_point

  !> Lambert's W: the solution of w exp(w) = z, by Newton's method; z > -1/e (a column of any height has z >= 0)
  pure real(dp) function lambert_w(z) result(w)
    real(dp), intent(in) :: z
    integer :: k
    real(dp) :: change
    w = log(1.0_dp + z) ! not below the root, within 0.3 of it for z up to 1, exact at z = 0
    do k = 1, 50
      change = (w - z*exp(-w))/(1.0_dp + z*exp(-w))
      w = w - change
      if (abs(change) <= 2.0_dp*epsilon(w)*abs(w)) exit
    end do
  end function lambert_w

  !> The whole body moves with one constant velocity
  pure subroutine translation_motion(v, t, u, vel, f)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t
    real(dp), intent(out) :: u(lanes, 3), vel(lanes, 3), f(lanes, 9)
    integer :: k
    call set_at_rest(u, vel, f)
    do k = 1, v%dim
      u(:, k) = v%velocity(k)*t
      vel(:, k) = v%velocity(k)
    end do
  end subroutine translation_motion

  !> Rigid rotation about `center` with the constant angular velocity w: x = c + R(wt)(X - c), v = w x (x - c).
  !>
  !> A free elastic body follows it up to the strain that its own spin causes, of order rho0 w^2 r^2/E.
  pure subroutine rotation_motion(v, t, x, u, vel, f)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: u(lanes, 3), vel(lanes, 3), f(lanes, 9)
    integer :: p, i, j
    real(dp) :: w(3), r(3, 3), d(3), y(3)
    call set_at_rest(u, vel, f)
    w = v%angular_velocity
    r = rotation_of(w, t)
    do p = 1, lanes
      d = x(p, :) - v%center
      do i = 1, 3
        y(i) = r(i, 1)*d(1) + r(i, 2)*d(2) + r(i, 3)*d(3)
        do j = 1, 3
          f(p, 3*(i - 1) + j) = r(i, j)
        end do
      end do
      u(p, :) = y - d
      vel(p, 1) = w(2)*y(3) - w(3)*y(2)
      vel(p, 2) = w(3)*y(1) - w(1)*y(3)
      vel(p, 3) = w(1)*y(2) - w(2)*y(1)
    end do
  end subroutine rotation_motion

  !> Rotation by the vector w t [Rodrigues]
  pure function rotation_of(w, t) result(r)
    real(dp), intent(in) :: w(3), t
    real(dp) :: r(3, 3), n(3), angle, c, s
    integer :: i
    angle = norm2(w)*t
    n = 0.0_dp
    if (norm2(w) > 0.0_dp) n = w/norm2(w)
    c = cos(angle)
    s = sin(angle)
    do i = 1, 3
      r(:, i) = (1.0_dp - c)*n*n(i)
      r(i, i) = r(i, i) + c
    end do
    r(1, 2) = r(1, 2) - s*n(3); r(2, 1) = r(2, 1) + s*n(3)
    r(1, 3) = r(1, 3) + s*n(2); r(3, 1) = r(3, 1) - s*n(2)
    r(2, 3) = r(2, 3) - s*n(1); r(3, 2) = r(3, 2) + s*n(1)
  end function rotation_of

end module gimp_exact_flat
