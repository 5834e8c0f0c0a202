!> The next step obeys every limit, says which one set it, and meets times of interest without tiny steps
program test_step_size
  use gimp_kinds, only: wp
  use gimp_step_size, only: time_options_t, next_step, limit_word, rule_adaptive, rule_uniform, rule_fixed
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: far = 1.0e9_wp, round_off = epsilon(1.0_wp)

  call begin_suite("step size")
  call test_limits()
  call test_critical()
  call test_prescribed()
  call test_meets_times()
  call end_suite()

contains

  !> h = 0.5, C = 0.4, growth 1.05: one limit after the other is made the strictest
  subroutine test_limits()
    type(time_options_t) :: options
    options%courant = 0.4_wp
    call expect(options, 10.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.02_wp, "courant")
    call expect(options, 10.0_wp, 20.0_wp, 0.0_wp, 0.0_wp, 0.0125_wp, "displacement")
    call expect(options, 10.0_wp, 12.0_wp, 0.0_wp, 0.0_wp, 0.02_wp, "courant")
    call expect(options, 10.0_wp, 0.0_wp, 20.0_wp, 0.0_wp, 0.005_wp, "strain")
    call expect(options, 10.0_wp, 20.0_wp, 20.0_wp, 0.0_wp, 0.005_wp, "strain")
    call expect(options, 10.0_wp, 0.0_wp, 0.0_wp, 0.01_wp, 0.0105_wp, "growth")
    call expect(options, 10.0_wp, 0.0_wp, 0.0_wp, 0.0199_wp, 0.02_wp, "courant")
  end subroutine test_limits

  subroutine expect(options, rate, speed, strain_rate, last, wanted, word)
    type(time_options_t), intent(in) :: options
    real(wp), intent(in) :: rate, speed, strain_rate, last, wanted
    character(len=*), intent(in) :: word
    real(wp) :: dt, free
    integer :: limit
    call next_step(options, 0.5_wp, rate, speed, strain_rate, huge(1.0_wp), last, far, dt, free, limit)
    call check(dt, wanted, 4*round_off*wanted, "step limited by "//word)
    call check(free, dt, 0.0_wp, "nothing shortened it")
    call check(limit_word(limit), word, "the limit is named")
  end subroutine expect

  !> A share of the critical step is a limit where the scene asks for it, and growth holds on the way back
  subroutine test_critical()
    type(time_options_t) :: options
    real(wp) :: dt, free
    integer :: limit
    options%courant = 0.4_wp
    call next_step(options, 0.5_wp, 10.0_wp, 0.0_wp, 0.0_wp, 0.01_wp, 0.0_wp, far, dt, free, limit)
    call check(dt, 0.02_wp, 4*round_off*0.02_wp, "reported only")
    options%most_of_critical = 0.8_wp
    call next_step(options, 0.5_wp, 10.0_wp, 0.0_wp, 0.0_wp, 0.01_wp, 0.0_wp, far, dt, free, limit)
    call check(dt, 0.008_wp, 4*round_off*0.008_wp, "a share of the critical step")
    call check(limit_word(limit), "stability", "has its name")
    call next_step(options, 0.5_wp, 10.0_wp, 0.0_wp, 0.0_wp, 0.01_wp, 0.004_wp, far, dt, free, limit)
    call check(limit_word(limit), "growth", "growth after it")
    call next_step(options, 0.5_wp, 10.0_wp, 0.0_wp, 0.0_wp, huge(1.0_wp), 0.0_wp, far, dt, free, limit)
    call check(limit_word(limit), "courant", "nothing limits a state without a critical step")
  end subroutine test_critical

  subroutine test_prescribed()
    type(time_options_t) :: options
    real(wp) :: dt, free
    integer :: limit
    options%rule = rule_fixed
    options%step = 0.125_wp
    call next_step(options, 0.5_wp, 1.0e6_wp, 1.0e6_wp, 1.0e6_wp, huge(1.0_wp), 1.0e-3_wp, 0.01_wp, dt, free, limit)
    call check(dt, 0.125_wp, 0.0_wp, "a fixed step obeys no limit")
    call check(limit_word(limit), "prescribed", "and says so")
    options%rule = rule_uniform
    call next_step(options, 0.5_wp, 1.0e6_wp, 1.0e6_wp, 1.0e6_wp, huge(1.0_wp), 1.0e-3_wp, 0.01_wp, dt, free, limit)
    call check(dt, 0.125_wp, 0.0_wp, "nor does a uniform one")
    call check_true(options%rule /= rule_adaptive, "both are not the adaptive rule")
  end subroutine test_prescribed

  !> Steps of 0.02 towards a time of interest: never longer than allowed, never a crumb at the end, and the time is met
  subroutine test_meets_times()
    type(time_options_t) :: options
    real(wp) :: dt, free, last, until, shortest
    integer :: limit, k, steps, too_long
    options%courant = 0.4_wp
    call next_step(options, 0.5_wp, 10.0_wp, 0.0_wp, 0.0_wp, huge(1.0_wp), 0.0_wp, 0.05_wp, dt, free, limit)
    call check(dt, 0.05_wp/3, round_off, "two and a half steps become three")
    call check(free, 0.02_wp, round_off, "the unshortened step is remembered for the growth limit")
    call check(limit_word(limit), "output", "shortened for output")
    call next_step(options, 0.5_wp, 10.0_wp, 0.0_wp, 0.0_wp, huge(1.0_wp), 0.0_wp, 0.02_wp*(1 + 1.0e-10_wp), dt, free, limit)
    call check(dt, 0.02_wp, 1.0e-11_wp, "a hair above one step stays one step")
    call check(limit_word(limit), "courant", "and is not called shortened")
    too_long = 0
    shortest = far
    do k = 1, 200
      until = 0.0017_wp*k
      last = 0.0_wp
      steps = 0
      do while (until > 1.0e-15_wp .and. steps < 100)
        call next_step(options, 0.5_wp, 10.0_wp, 0.0_wp, 0.0_wp, huge(1.0_wp), last, until, dt, free, limit)
        if (dt > 0.02_wp*(1 + 1.0e-8_wp)) too_long = too_long + 1
        if (0.0017_wp*k > 0.02_wp) shortest = min(shortest, dt)
        until = until - dt
        last = free
        steps = steps + 1
      end do
      if (abs(until) > 1.0e-15_wp .or. steps > ceiling(0.0017_wp*k/0.02_wp) + 1) too_long = too_long + 1000
    end do
    call check(too_long, 0, "the time is met in as few steps as the limit allows")
    call check_true(shortest > 0.0099_wp, "no step is less than half of what was allowed")
  end subroutine test_meets_times

end program test_step_size
