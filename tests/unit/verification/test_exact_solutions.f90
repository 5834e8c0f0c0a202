!> Exact solutions obey the balance of momentum, and their velocities and deformation gradients belong to their displacements.
!>
!> Derivatives by fourth-order central differences. Their error: truncation about (k h)^4/30 with k h near 0.005, some 1e-11,
!> and round-off about 1e-16/0.005 times the ratio of the largest term to the sum; both relative, the largest seen is 3e-10
!> (vortex). A wrong coefficient anywhere shows as 1e-3 or more.
program test_exact_solutions
  use gimp_kinds, only: wp, lanes
  use gimp_error, only: error_t
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_verification, only: verification_t, verification_options_t, make_verification, exact_motion, &
    exact_displacement, exact_velocity, exact_deformation, exact_stress, body_force, has_body_force
  implicit none(type, external)

  real(wp), parameter :: offset(4) = [-2.0_wp, -1.0_wp, 1.0_wp, 2.0_wp]
  real(wp), parameter :: weight(4) = [1.0_wp, -8.0_wp, 8.0_wp, -1.0_wp]/12.0_wp
  real(wp), parameter :: tolerance = 2.0e-9_wp !! relative; see above
  type(verification_options_t) :: options
  type(verification_t) :: v
  real(wp) :: x(lanes, 3), no_force(3)

  call begin_suite("exact_solutions")
  no_force = 0.0_wp

  options = verification_options_t(solution="vibrating_bar")
  call points([0.0_wp, 0.0_wp, 0.0_wp], [25.0_wp, 1.0_wp, 1.0_wp], x)
  call examine(1, "linear_elastic", 1.0_wp, 100.0_wp, 0.0_wp, 3.7_wp, 1.0e-2_wp, 1.0e-2_wp, "bar")
  call examine(1, "hencky", 1.0_wp, 100.0_wp, 0.3_wp, 3.7_wp, 1.0e-2_wp, 1.0e-2_wp, "bar, nu = 0.3")
  call examine(3, "neo_hookean", 1.0_wp, 100.0_wp, 0.0_wp, 11.0_wp, 1.0e-2_wp, 1.0e-2_wp, "bar in 3D")

  options = verification_options_t(solution="axis_aligned")
  call points([0.02_wp, 0.02_wp, 0.02_wp], [0.98_wp, 0.98_wp, 0.98_wp], x)
  call examine(1, "neo_hookean", 1.0e3_wp, 1.0e7_wp, 0.3_wp, 0.0037_wp, 1.0e-3_wp, 1.0e-5_wp, "axis-aligned 1D")
  call examine(2, "neo_hookean", 1.0e3_wp, 1.0e7_wp, 0.3_wp, 0.0037_wp, 1.0e-3_wp, 1.0e-5_wp, "axis-aligned 2D")
  call examine(3, "neo_hookean", 1.0e3_wp, 1.0e7_wp, 0.3_wp, 0.0037_wp, 1.0e-3_wp, 1.0e-5_wp, "axis-aligned 3D")
  options%phases = [0.3_wp, 1.1_wp, 2.0_wp]
  options%amplitude = 0.2_wp
  call examine(3, "neo_hookean", 1.0e3_wp, 1.0e7_wp, 0.2_wp, 0.0052_wp, 1.0e-3_wp, 1.0e-5_wp, &
    "axis-aligned 3D, large, other phases")

  options = verification_options_t(solution="vortex")
  call points_of_ring(0.76_wp, 1.24_wp, [0.0_wp, 0.0_wp], x)
  call examine(2, "neo_hookean", 1.0e3_wp, 1.0e3_wp, 0.3_wp, 0.37_wp, 1.0e-3_wp, 1.0e-3_wp, "vortex")
  call examine(2, "neo_hookean", 1.0e3_wp, 1.0e3_wp, 0.3_wp, 0.81_wp, 1.0e-3_wp, 1.0e-3_wp, "vortex, late")
  options%center = [2.0_wp, -1.0_wp, 0.0_wp]
  options%inner_radius = 0.3_wp
  options%outer_radius = 1.1_wp
  options%period = 0.7_wp
  options%amplitude = 0.6_wp
  call points_of_ring(0.32_wp, 1.08_wp, [2.0_wp, -1.0_wp], x)
  call examine(3, "neo_hookean", 7.0e2_wp, 1.0e3_wp, 0.1_wp, 0.3_wp, 1.0e-3_wp, 1.0e-3_wp, "vortex of other size, 3D")

  options = verification_options_t(solution="expanding_ring")
  call points_of_ring(0.41_wp, 0.59_wp, [0.0_wp, 0.0_wp], x)
  call examine(2, "neo_hookean", 1.0e3_wp, 1.0e7_wp, 0.0_wp, 0.0021_wp, 5.0e-4_wp, 1.0e-5_wp, "ring")
  call examine(3, "neo_hookean", 1.0e3_wp, 1.0e7_wp, 0.0_wp, 0.0101_wp, 5.0e-4_wp, 1.0e-5_wp, "ring, later, 3D")
  call free_faces()

  options = verification_options_t(solution="self_weight_column")
  call points([0.0_wp, 0.0_wp, 0.0_wp], [50.0_wp, 50.0_wp, 50.0_wp], x)
  no_force = [-10.0_wp, 0.0_wp, 0.0_wp]
  call examine(1, "hencky", 80.0_wp, 1.0e6_wp, 0.0_wp, 0.0_wp, 5.0e-2_wp, 1.0_wp, "column, Hencky")
  no_force = [0.0_wp, -10.0_wp, 0.0_wp]
  call examine(2, "neo_hookean", 80.0_wp, 1.0e6_wp, 0.0_wp, 0.0_wp, 5.0e-2_wp, 1.0_wp, "column, neo-Hookean")
  no_force = [0.0_wp, 0.0_wp, -10.0_wp]
  call examine(3, "linear_elastic", 80.0_wp, 1.0e6_wp, 0.0_wp, 0.0_wp, 5.0e-2_wp, 1.0_wp, "column, rate law")

  no_force = 0.0_wp
  options = verification_options_t(solution="rigid_translation", velocity=[0.7_wp, -0.3_wp, 0.2_wp])
  call points([0.0_wp, 0.0_wp, 0.0_wp], [1.0_wp, 1.0_wp, 1.0_wp], x)
  call examine(3, "drucker_prager", 1.0e3_wp, 1.0e7_wp, 0.3_wp, 0.9_wp, 1.0e-3_wp, 1.0e-2_wp, "translation")
  options = verification_options_t(solution="rigid_rotation", angular_velocity=[1.2_wp, -0.7_wp, 2.0_wp])
  options%center = [0.5_wp, 0.4_wp, 0.3_wp]
  call examine(3, "hencky", 1.0e3_wp, 1.0e7_wp, 0.3_wp, 0.9_wp, 1.0e-3_wp, 1.0e-3_wp, "rotation")

  call end_suite()

contains

  !> Momentum balance, F = I + grad u, velocity = du/dt at `x` and time t
  subroutine examine(dim, model, density, young, poisson, t, h, dt, what)
    integer, intent(in) :: dim
    character(len=*), intent(in) :: model, what
    real(wp), intent(in) :: density, young, poisson, t, h, dt
    type(error_t), allocatable :: error
    real(wp), dimension(lanes, 3) :: y, u, vel, u_t, v_t, b, residual
    real(wp), dimension(lanes, 9) :: f, grad, p
    real(wp) :: div(lanes, 3), scale
    integer :: k, j, i
    type(verification_options_t) :: chosen
    chosen = options
    call make_verification(chosen, dim, model, density, young, poisson, v, error)
    call check_true(.not. allocated(error), what//": is accepted")
    y = x
    y(:, dim + 1:) = 0.0_wp
    u_t = 0.0_wp; v_t = 0.0_wp; div = 0.0_wp; grad = 0.0_wp
    do j = 1, 4
      call exact_displacement(v, t + offset(j)*dt, y, u)
      u_t = u_t + weight(j)*u/dt
      call exact_velocity(v, t + offset(j)*dt, y, vel)
      v_t = v_t + weight(j)*vel/dt
    end do
    do k = 1, 3
      do j = 1, 4
        y(:, k) = y(:, k) + offset(j)*h
        call exact_displacement(v, t, y, u)
        call first_piola(t, y, p)
        y(:, k) = y(:, k) - offset(j)*h
        do i = 1, 3
          grad(:, 3*(i - 1) + k) = grad(:, 3*(i - 1) + k) + weight(j)*u(:, i)/h
          if (k <= dim) div(:, i) = div(:, i) + weight(j)*p(:, 3*(i - 1) + k)/h
        end do
      end do
    end do
    grad(:, 1::4) = grad(:, 1::4) + 1.0_wp
    call exact_motion(v, t, y, u, vel, f)
    call body_force(v, t, y, b)
    do k = 1, 3
      b(:, k) = b(:, k) + no_force(k)
    end do
    if (options%solution == "rigid_rotation") b = centripetal(y + u)
    residual = div + v%density*(b - v_t)
    scale = maxval(abs(div)) + v%density*maxval(abs(v_t)) + 0.1_wp ! the floor serves those where all is zero
    call check(maxval(abs(residual))/scale, 0.0_wp, tolerance, what//": div P + rho0 b = rho0 a")
    call check(maxval(abs(grad - f)), 0.0_wp, tolerance, what//": F = I + grad u")
    call check(maxval(abs(u_t - vel))/(maxval(abs(vel)) + 1.0e-3_wp), 0.0_wp, tolerance, what//": v = du/dt")
    if (has_body_force(v)) call check_true(maxval(abs(v%density*b)) > 1.0e-3_wp*scale, what//": the force matters")
  end subroutine examine

  !> w x (w x r): what holds a rotating body together
  function centripetal(place) result(b)
    real(wp), intent(in) :: place(lanes, 3)
    real(wp) :: b(lanes, 3)
    integer :: n
    do n = 1, lanes
      b(n, :) = cross(v%angular_velocity, cross(v%angular_velocity, place(n, :) - v%center))
    end do
  end function centripetal

  !> P = J sigma F^-T = sigma cof(F). The bar is a small-strain solution, for which P is sigma.
  subroutine first_piola(t, y, p)
    real(wp), intent(in) :: t, y(lanes, 3)
    real(wp), intent(out) :: p(lanes, 9)
    real(wp) :: f(lanes, 9), s(lanes, 6), a(3, 3), cof(3, 3), sig(3, 3)
    integer :: n
    call exact_deformation(v, t, y, f)
    call exact_stress(v, t, y, s)
    do n = 1, lanes
      a = transpose(reshape(f(n, :), [3, 3]))
      cof(:, 1) = cross(a(:, 2), a(:, 3))
      cof(:, 2) = cross(a(:, 3), a(:, 1))
      cof(:, 3) = cross(a(:, 1), a(:, 2))
      sig = reshape([s(n, 1), s(n, 4), s(n, 6), s(n, 4), s(n, 2), s(n, 5), s(n, 6), s(n, 5), s(n, 3)], [3, 3])
      if (options%solution /= "vibrating_bar") sig = matmul(sig, cof)
      p(n, :) = reshape(transpose(sig), [9])
    end do
  end subroutine first_piola

  pure function cross(a, b) result(c)
    real(wp), intent(in) :: a(3), b(3)
    real(wp) :: c(3)
    c = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
  end function cross

  !> The ring pushes on nothing at its faces: P_rr = 0 at R = Ri and Ro
  subroutine free_faces()
    real(wp) :: y(lanes, 3), p(lanes, 9)
    y = 0.0_wp
    y(:, 1) = 0.5_wp
    y(1, 1) = 0.4_wp
    y(2, 1) = 0.6_wp
    call first_piola(0.003_wp, y, p)
    call check(p(1:2, 1)/1.0e7_wp, [0.0_wp, 0.0_wp], 1.0e-14_wp, "ring: faces free of traction (round-off of E)")
    call check_true(abs(p(3, 1)) > 1.0e4_wp, "ring: stressed inside")
  end subroutine free_faces

  !> Points spread over a box; golden-ratio steps, so that nothing is special about them
  subroutine points(low, high, y)
    real(wp), intent(in) :: low(3), high(3)
    real(wp), intent(out) :: y(lanes, 3)
    integer :: n
    do n = 1, lanes
      y(n, :) = low + (high - low)*(0.03_wp + 0.94_wp*modulo(n*[0.754877666_wp, 0.569840291_wp, 0.618033989_wp], 1.0_wp))
    end do
  end subroutine points

  !> Points spread over a ring
  subroutine points_of_ring(inner, outer, center, y)
    real(wp), intent(in) :: inner, outer, center(2)
    real(wp), intent(out) :: y(lanes, 3)
    real(wp) :: r
    integer :: n
    do n = 1, lanes
      r = inner + (outer - inner)*modulo(n*0.754877666_wp, 1.0_wp)
      y(n, :) = [center(1) + r*cos(2.4_wp*n), center(2) + r*sin(2.4_wp*n), 0.3_wp*n]
    end do
  end subroutine points_of_ring

end program test_exact_solutions
