!> Factors in time: constant, smooth ramp, piecewise-linear table
program test_time_table
  use gimp_kinds, only: wp
  use gimp_time_table, only: time_table_t, factor_at, smooth_ramp
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: round_off = epsilon(1.0_wp)

  call begin_suite("time table")
  call test_constant()
  call test_table()
  call test_ramp()
  call end_suite()

contains

  subroutine test_constant()
    type(time_table_t) :: table
    call check(factor_at(table, 0.0_wp), 1.0_wp, 0.0_wp, "without a table the factor is one")
    call check(factor_at(table, 1.0e9_wp), 1.0_wp, 0.0_wp, "for ever")
    table%times = [real(wp) ::]
    table%factors = [real(wp) ::]
    call check(factor_at(table, 3.0_wp), 1.0_wp, 0.0_wp, "an empty table is none")
  end subroutine test_constant

  subroutine test_table()
    type(time_table_t) :: table
    table%times = [1.0_wp, 2.0_wp, 4.0_wp]
    table%factors = [0.5_wp, -1.0_wp, 3.0_wp]
    call check(factor_at(table, -5.0_wp), 0.5_wp, 0.0_wp, "before the first time its factor holds")
    call check(factor_at(table, 1.0_wp), 0.5_wp, 0.0_wp, "at the first time")
    call check(factor_at(table, 1.5_wp), -0.25_wp, round_off, "linear between")
    call check(factor_at(table, 2.0_wp), -1.0_wp, round_off, "at a time of the table")
    call check(factor_at(table, 3.5_wp), 2.0_wp, 4*round_off, "linear in the next piece")
    call check(factor_at(table, 4.0_wp), 3.0_wp, 0.0_wp, "at the last time")
    call check(factor_at(table, 9.0_wp), 3.0_wp, 0.0_wp, "after it")
    table%times = [2.0_wp]
    table%factors = [0.25_wp]
    call check(factor_at(table, 7.0_wp), 0.25_wp, 0.0_wp, "one entry holds always")
  end subroutine test_table

  !> 10 s^3 - 15 s^4 + 6 s^5: symmetric about the middle, and flat to second order at both ends: at s = 1e-3 from an end only
  !> 10 s^3 is left
  subroutine test_ramp()
    type(time_table_t) :: table
    real(wp) :: s
    integer :: k, down
    call check(smooth_ramp(-1.0_wp), 0.0_wp, 0.0_wp, "nothing before the start")
    call check(smooth_ramp(0.5_wp), 0.5_wp, round_off, "half at the middle")
    call check(smooth_ramp(0.25_wp), 10*0.25_wp**3 - 15*0.25_wp**4 + 6*0.25_wp**5, round_off, "the polynomial")
    call check(smooth_ramp(2.0_wp), 1.0_wp, 0.0_wp, "all after the end")
    call check(smooth_ramp(1.0e-3_wp), 1.0e-8_wp, 2.0e-11_wp, "third order at the start")
    call check(1.0_wp - smooth_ramp(1.0_wp - 1.0e-3_wp), 1.0e-8_wp, 2.0e-11_wp, "third order at the end")
    down = 0
    do k = 1, 100
      s = 0.01_wp*k
      if (smooth_ramp(s) <= smooth_ramp(s - 0.01_wp)) down = down + 1
    end do
    call check(down, 0, "always upwards")
    table%ramp_time = 4.0_wp
    call check(factor_at(table, 1.0_wp), smooth_ramp(0.25_wp), 0.0_wp, "stretched to the ramp time")
    call check(factor_at(table, 5.0_wp), 1.0_wp, 0.0_wp, "and full afterwards")
  end subroutine test_ramp

end program test_time_table
