!> Explicit Newmark: a particle right on a node, whose neighbours are cut off, is an oscillator of omega = c/h. It grows from the limit
!> of the formula on, keeps its energy below it with gamma = 1/2 and loses it with more
program test_newmark
  use gimp_kinds, only: wp, dp
  use gimp_basis, only: basis_linear
  use gimp_error, only: error_t
  use gimp_engine_fixture, only: cloud_t, make_cloud, make_engine, read_cloud
  use gimp_newmark, only: newmark_limit
  use gimp_run_state, only: stepper_t, usl, newmark
  use gimp_step_size, only: rule_fixed
  use gimp_stepper, only: start_run, plan_step, take_step
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.1_wp, speed = sqrt(1.4_wp) !! of the unstressed material of the fixture [m/s]
  real(wp), parameter :: strain = 1.0e-7_wp

  call begin_suite("newmark")
  call test_limit(0.5_wp)
  call test_limit(0.6_wp)
  call test_trapezoid()
  call end_suite()

contains

  !> By bisection, to 1 %
  subroutine test_limit(gamma)
    real(wp), intent(in) :: gamma
    real(wp) :: low, high, middle
    integer :: k
    low = 0.1_wp
    high = 3.0_wp
    do k = 1, 11
      middle = 0.5_wp*(low + high)
      if (strain_after(gamma, middle, 600) > 10*strain) then
        high = middle
      else
        low = middle
      end if
    end do
    call check(middle/newmark_limit(gamma), 1.0_wp, 0.01_wp, "limit of an oscillator")
  end subroutine test_limit

  !> With gamma = 1/2 the strain is cos(n theta), sin(theta/2) = omega dt/2: at a third of a radian a step to 1e-6 after 300 steps (the
  !> material is not quite linear at a strain of 1e-7); with gamma = 0.6 waves decay like exp(-(gamma - 1/2) (omega dt)^2 n/2)
  subroutine test_trapezoid()
    real(wp), parameter :: omega = 0.3_wp
    real(wp) :: angle
    integer :: n
    angle = 2*asin(0.5_wp*omega)
    n = 300
    call check(strain_after(0.5_wp, omega, n)/strain, abs(cos(n*angle)), 1.0e-4_wp, "the trapezoidal rule")
    call check_true(strain_after(0.6_wp, omega, n) < 1.1_wp*exp(-0.05_wp*omega**2*n)*strain, "more than half damps")
  end subroutine test_trapezoid

  !> Strain that is left of a small one; huge if the run fails
  real(wp) function strain_after(gamma, omega, steps) result(left)
    real(wp), intent(in) :: gamma, omega !! omega dt
    integer, intent(in) :: steps
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    type(error_t), allocatable :: error
    integer :: k
    call make_cloud(1, cloud)
    cloud%x(1, 1) = 5
    cloud%f(1, 1) = 1 + strain
    cloud%volume = spacing
    cloud%mass = 1000*cloud%volume
    call make_engine(1, basis_linear, [12, 1, 1], spacing, cloud, s%engine, acceleration=.true.)
    s%method%integrator = newmark
    s%method%newmark_gamma = gamma
    s%method%scheme = usl
    s%method%cutoff = 1.0e-3_wp
    s%engine%f_update = 2
    s%time_options%rule = rule_fixed
    s%time_options%step = omega*spacing/speed
    call start_run(s, error)
    do k = 1, steps
      if (.not. allocated(error)) call plan_step(s, 1.0e9_dp, error)
      if (.not. allocated(error)) call take_step(s, error)
    end do
    left = huge(1.0_wp)
    if (allocated(error)) return
    call read_cloud(s%engine, cloud)
    left = abs(cloud%f(1, 1) - 1)
  end function strain_after

end program test_newmark
