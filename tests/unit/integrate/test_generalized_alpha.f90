!> Explicit generalised-alpha: constants and limits against the spectrum of its amplification, and real particles that grow where
!> the formulas say
program test_generalized_alpha
  use gimp_kinds, only: wp, dp
  use gimp_basis, only: basis_linear
  use gimp_error, only: error_t
  use gimp_engine_fixture, only: cloud_t, make_cloud, make_engine, read_cloud
  use gimp_generalized_alpha, only: alpha_t, make_alpha, advance_free, bifurcation_limit, stability_limit, mapped_limit
  use gimp_run_state, only: stepper_t, usl, generalized_alpha
  use gimp_stability, only: check_lanczos
  use gimp_step_size, only: rule_fixed
  use gimp_stepper, only: start_run, plan_step, take_step
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: radii(5) = [0.0_wp, 0.6_wp, 0.8_wp, 0.9_wp, 1.0_wp]
  real(wp), parameter :: spacing = 0.1_wp, speed = sqrt(1.4_wp) !! of the unstressed material of the fixture [m/s]
  integer :: k

  call begin_suite("generalized_alpha")
  call test_table()
  do k = 1, size(radii)
    call test_oscillator(radii(k))
    call test_mapping(radii(k))
  end do
  call test_particle_on_node(1.0_wp)
  call test_particle_on_node(0.8_wp)
  call test_particle_in_cell(1.0_wp)
  call test_particle_in_cell(0.8_wp)
  call end_suite()

contains

  !> The constants of Hulbert & Chung (1996), to the digits that were tabulated
  subroutine test_table()
    type(alpha_t) :: c(size(radii))
    c = make_alpha(radii)
    call check(c%am, [-1.0_wp, 0.125_wp, 0.3333_wp, 0.4211_wp, 0.5_wp], 5.0e-5_wp, "alpha_m")
    call check(c%be, [2.5_wp, 0.8929_wp, 0.6687_wp, 0.5792_wp, 0.5_wp], 5.0e-5_wp, "beta")
    call check(c%ga, [2.5_wp, 1.375_wp, 1.1667_wp, 1.0789_wp, 1.0_wp], 5.0e-5_wp, "gamma")
    call check(bifurcation_limit(radii), [1.4142_wp, 1.8931_wp, 1.9718_wp, 1.9927_wp, 2.0_wp], 5.0e-5_wp, "Omega_b")
    call check(stability_limit(radii), [1.5492_wp, 1.9111_wp, 1.9758_wp, 1.9937_wp, 2.0_wp], 5.0e-5_wp, "Omega_s")
  end subroutine test_table

  !> rho_b at the bifurcation, growth from the stability limit on, both to 1 %; in between the short waves are damped most
  subroutine test_oscillator(radius)
    real(wp), intent(in) :: radius
    real(wp) :: limit
    character(len=:), allocatable :: which
    which = ", rho_b = "//text_of(radius)
    call check(spectral_radius(radius, bifurcation_limit(radius), 1.0_wp), radius, 0.01_wp, "radius at the bifurcation"//which)
    limit = first_growth(radius, 1.0_wp)
    call check(limit/stability_limit(radius), 1.0_wp, 0.01_wp, "stability limit of the oscillator"//which)
    call check_true(spectral_radius(radius, 0.1_wp, 1.0_wp) > 0.99_wp, "long waves are kept"//which)
  end subroutine test_oscillator

  !> A mode that the particles keep the share p of: stable below `mapped_limit` for every p, and not much beyond for p near 0
  subroutine test_mapping(radius)
    real(wp), intent(in) :: radius
    integer :: k
    do k = 1, 20
      call check_true(first_growth(radius, 0.05_wp*k) > 0.999_wp*mapped_limit(radius), "no mode is worse than the limit of scenes")
    end do
    call check(first_growth(radius, 1.0e-3_wp)/mapped_limit(radius), 1.0_wp, 0.01_wp, "which a mode that is not kept has")
  end subroutine test_mapping

  !> Where the oscillator begins to grow [omega dt], by bisection
  real(wp) function first_growth(radius, share) result(limit)
    real(wp), intent(in) :: radius, share
    real(wp) :: low, high
    integer :: k
    low = 1.0_wp
    high = 2.5_wp
    do k = 1, 14
      limit = 0.5_wp*(low + high)
      if (spectral_radius(radius, limit, share) > 1.0_wp + 1.0e-5_wp) then ! double roots on the circle grow like the logarithm
        high = limit
      else
        low = limit
      end if
    end do
  end function first_growth

  !> Spectral radius of the step of an oscillator, by squaring its matrix; particles keep `share` of new velocity and acceleration
  real(wp) function spectral_radius(radius, omega, share) result(rho)
    real(wp), intent(in) :: radius, omega, share !! omega dt
    real(wp) :: a(3, 3), x(3), a1, u, w, size, logarithm
    type(alpha_t) :: c
    integer :: k
    c = make_alpha(radius)
    do k = 1, 3
      x = 0.0_wp
      x(k) = 1.0_wp
      call advance_free(c, 1.0_wp, -omega**2*x(1), x(3), x(2), a1, u, w)
      a(:, k) = [x(1) + u, x(2) + share*(w - x(2)), share*a1]
    end do
    logarithm = 0.0_wp
    do k = 1, 24 ! |A^n|^(1/n), n = 2^24
      size = maxval(abs(a))
      if (.not. size > tiny(1.0_wp)) exit
      logarithm = logarithm + log(size)/2.0_wp**(k - 1)
      a = a/size
      a = matmul(a, a)
    end do
    rho = exp(logarithm)
    if (k <= 24) rho = 0.0_wp
  end function spectral_radius

  !> A particle right on a node, whose neighbours are cut off, is the oscillator itself: one degree of freedom, omega = c/h, and all
  !> that the node has is the particle's. By bisection the run grows from the stability limit of the formula on, to 1 %
  subroutine test_particle_on_node(radius)
    real(wp), intent(in) :: radius
    call check(grows_from(radius, 5.0_wp, 1.0e-3_wp)*speed/spacing/stability_limit(radius), 1.0_wp, 0.01_wp, &
               "particle on a node, rho_b = "//text_of(radius))
  end subroutine test_particle_on_node

  !> A free particle at the share xi of a cell: omega = c/(h sqrt(xi (1 - xi))), and the grid keeps nothing of it
  subroutine test_particle_in_cell(radius)
    real(wp), intent(in) :: radius
    real(wp) :: limit
    limit = mapped_limit(radius)*sqrt(0.3_wp*0.7_wp)*spacing/speed
    call check(grows_from(radius, 5.3_wp, 0.0_wp)/limit, 1.0_wp, 0.01_wp, "particle in a cell, rho_b = "//text_of(radius))
    call check(critical(radius, 5.3_wp)/limit, 1.0_wp, 1.0e-6_wp, "the critical step knows it, rho_b = "//text_of(radius))
  end subroutine test_particle_in_cell

  !> Step from which on a slightly strained particle is left with more strain after 600 steps [s], by bisection
  real(wp) function grows_from(radius, place, cutoff) result(step)
    real(wp), intent(in) :: radius, place, cutoff !! [cells], share of the particle mass
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    type(error_t), allocatable :: error
    real(wp) :: low, high
    integer :: trial, k
    low = 0.1_wp*spacing/speed
    high = 3.0_wp*spacing/speed
    do trial = 1, 11
      step = 0.5_wp*(low + high)
      call one_particle(radius, place, cutoff, step, s)
      if (allocated(error)) deallocate (error)
      call start_run(s, error)
      do k = 1, 600
        if (.not. allocated(error)) call plan_step(s, 1.0e9_dp, error)
        if (.not. allocated(error)) call take_step(s, error)
      end do
      if (.not. allocated(error)) call read_cloud(s%engine, cloud)
      if (allocated(error)) then
        high = step
      else if (abs(cloud%f(1, 1) - 1.0_wp) > 1.0e-6_wp) then ! ten times what it was
        high = step
      else
        low = step
      end if
    end do
  end function grows_from

  !> The critical step that the check finds
  real(wp) function critical(radius, place)
    real(wp), intent(in) :: radius, place
    type(stepper_t) :: s
    type(error_t), allocatable :: error
    call one_particle(radius, place, 0.0_wp, 1.0e-3_wp, s)
    s%time_options%check = check_lanczos
    call start_run(s, error)
    call plan_step(s, 1.0e9_dp, error)
    critical = real(s%critical, wp)
  end function critical

  subroutine one_particle(radius, place, cutoff, step, s)
    real(wp), intent(in) :: radius, place, cutoff, step
    type(stepper_t), intent(out) :: s
    type(cloud_t) :: cloud
    call make_cloud(1, cloud)
    cloud%x(1, 1) = place
    cloud%f(1, 1) = 1.0_wp + 1.0e-7_wp
    cloud%volume = spacing
    cloud%mass = 1000*cloud%volume
    call make_engine(1, basis_linear, [12, 1, 1], spacing, cloud, s%engine, acceleration=.true.)
    s%method%integrator = generalized_alpha
    s%method%spectral_radius = radius
    s%method%scheme = usl
    s%method%cutoff = cutoff
    s%time_options%rule = rule_fixed
    s%time_options%step = step
    s%engine%f_update = 2
  end subroutine one_particle

end program test_generalized_alpha
