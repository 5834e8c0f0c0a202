!> Single values: what counts as a number, exact text, ranges in words
program test_scene_values
  use gimp_common_kinds, only: dp
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_scene_values, only: parse_real, parse_integer, parse_logical, exact_text, quoted_text, in_range, range_words, &
                               count_values, nth_value
  implicit none(type, external)

  call begin_suite("scene values")
  call test_numbers()
  call test_refused_numbers()
  call test_wholes_and_logicals()
  call test_exact_text()
  call test_ranges()
  call end_suite()

contains

  !> Every way to write a number; reading is exact, so the tolerance is zero
  subroutine test_numbers()
    call real_is("1", 1.0_dp)
    call real_is("-1.5", -1.5_dp)
    call real_is("+.5", 0.5_dp)
    call real_is("5.", 5.0_dp)
    call real_is("1e3", 1000.0_dp)
    call real_is("1.0D-3", 0.001_dp)
    call real_is("2.5E+02", 250.0_dp)
    call real_is("0.0", 0.0_dp)
    call real_is("0e999999999999", 0.0_dp)
    call real_is("1e-400", 0.0_dp)
    call real_is("0.00001e10", 1.0e5_dp)
    call real_is("100000e302", 1.0e307_dp)
  end subroutine test_numbers

  subroutine test_refused_numbers()
    character(len=*), parameter :: wrong(14) = [character(len=12) :: "", "abc", "1.2.3", "1e", "e5", ".", "-", "1+3", "1,5", &
                                                "0x10", "1e5.0", "--1", "1.0f", "1_8"]
    character(len=*), parameter :: wild(9) = [character(len=16) :: "nan", "NaN", "-inf", "Infinity", "+INF", "nan(0)", &
                                              "1e400", "1e308", "1e99999999999"]
    integer :: k
    do k = 1, size(wrong)
      call status_is(trim(wrong(k)), 1)
    end do
    do k = 1, size(wild)
      call status_is(trim(wild(k)), 2)
    end do
  end subroutine test_refused_numbers

  subroutine real_is(text, expected)
    character(len=*), intent(in) :: text
    real(dp), intent(in) :: expected
    real(dp) :: value
    integer :: status
    call parse_real(text, value, status)
    call check(status, 0, "number "//text)
    call check(value, expected, 0.0_dp, "number "//text)
  end subroutine real_is

  subroutine status_is(text, expected)
    character(len=*), intent(in) :: text
    integer, intent(in) :: expected
    real(dp) :: value
    integer :: status
    call parse_real(text, value, status)
    call check(status, expected, "status of '"//text//"'")
    call check(value, 0.0_dp, 0.0_dp, "value of refused '"//text//"'")
  end subroutine status_is

  subroutine test_wholes_and_logicals()
    integer :: value, status
    logical :: truth
    call parse_integer("-042", value, status)
    call check_true(status == 0 .and. value == -42, "a whole number with sign and leading zero")
    call parse_integer("2147483647", value, status)
    call check_true(status == 0 .and. value == huge(value), "the largest whole number")
    call parse_integer("2147483648", value, status)
    call check(status, 2, "one more is too large")
    call parse_integer("2.0", value, status)
    call check(status, 1, "2.0 is not written as a whole number")
    call parse_integer("+", value, status)
    call check(status, 1, "a sign alone")
    call parse_logical(".TRUE.", truth, status)
    call check_true(status == 0 .and. truth, ".TRUE.")
    call parse_logical("f", truth, status)
    call check_true(status == 0 .and. .not. truth, "f")
    call parse_logical("1", truth, status)
    call check(status, 1, "1 is no logical")
  end subroutine test_wholes_and_logicals

  !> What is written reads back as the same bits
  subroutine test_exact_text()
    real(dp) :: value, again
    integer :: k, status
    call check(exact_text(0.1_dp), "0.1", "shortest text")
    call check(exact_text(3.0_dp), "3.0", "a real stays a real")
    call check(exact_text(1.0e-12_dp), "1e-12", "shortest exponent")
    value = 1.0_dp
    do k = 1, 600
      value = -value*1.7320508075688772_dp
      if (k == 300) value = 1.1e-160_dp
      call parse_real(exact_text(value), again, status)
      call check_true(status == 0 .and. again == value, "exact text "//exact_text(value))
    end do
    call check(quoted_text('a "b"'), '"a ""b"""', "quotes are doubled")
  end subroutine test_exact_text

  subroutine test_ranges()
    call check_true(in_range(0.5_dp, "(0,1]") .and. in_range(1.0_dp, "(0,1]"), "inside a half-open range")
    call check_true(.not. in_range(0.0_dp, "(0,1]") .and. .not. in_range(1.5_dp, "(0,1]"), "outside a half-open range")
    call check_true(in_range(-1.0e30_dp, "") .and. in_range(1.0e30_dp, "[1,)"), "open ends")
    call check_true(.not. in_range(1.0_dp, "(,1)"), "only an upper end")
    call check(range_words("(0,)"), "above 0", "range in words")
    call check(range_words("[0,89)"), "at least 0 and below 89", "range in words")
    call check(range_words("(0,1]"), "above 0 and at most 1", "range in words")
    call check(range_words("(-1,0.5)"), "between -1 and 0.5 (both excluded)", "range in words")
    call check(range_words("[1,16]"), "between 1 and 16", "range in words")
    call check(count_values("0,3.14,0"), 3, "values of a default")
    call check(count_values(""), 0, "values of no default")
    call check(nth_value("0,3.14,0", 2), "3.14", "second value of a default")
  end subroutine test_ranges

end program test_scene_values
