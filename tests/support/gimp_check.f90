!> The small check library of the unit tests.
!>
!> A suite is a program: `call begin_suite("name")`, then `call check(...)` in each case, then `call end_suite()`, which
!> ends with a non-zero exit code if a check failed or none was made.
module gimp_check
  use gimp_common_kinds, only: sp, dp
  use, intrinsic :: iso_fortran_env, only: error_unit, output_unit
  implicit none(type, external)
  private
  public :: begin_suite, end_suite, suite_failed, check, check_true

  integer :: made = 0, failed = 0
  character(len=64) :: suite = ""

  !> A value against the expected one; `atol` is absolute
  interface check
    module procedure check_scalar, check_array, check_scalar_single, check_array_single, check_integer, check_text
  end interface check

contains

  subroutine begin_suite(name)
    character(len=*), intent(in) :: name
    suite = name
    made = 0
    failed = 0
  end subroutine begin_suite

  subroutine end_suite()
    if (suite_failed()) stop 1, quiet=.true.
  end subroutine end_suite

  !> The closing line, and whether a check failed or none was made; for suites on several ranks, which end together
  logical function suite_failed()
    write (output_unit, "(2a,i0,a,i0,a)") trim(suite), ": ", made - failed, " of ", made, " checks passed"
    suite_failed = failed > 0 .or. made == 0
  end function suite_failed

  subroutine check_true(claim, what)
    logical, intent(in) :: claim
    character(len=*), intent(in) :: what !! the property that should hold
    made = made + 1
    if (claim) return
    failed = failed + 1
    write (error_unit, "(4a)") trim(suite), ": FAILED: ", what
  end subroutine check_true

  subroutine check_scalar(value, expected, atol, what)
    real(dp), intent(in) :: value, expected, atol
    character(len=*), intent(in) :: what
    made = made + 1
    if (abs(value - expected) <= atol) return ! written so that a NaN fails
    failed = failed + 1
    write (error_unit, "(4a,es24.16,a,es24.16,a,es9.2)") trim(suite), ": FAILED: ", what, ": got ", value, ", expected ", &
      expected, ", tolerance ", atol
  end subroutine check_scalar

  subroutine check_array(value, expected, atol, what)
    real(dp), intent(in) :: value(:), expected(:), atol
    character(len=*), intent(in) :: what
    integer :: k
    made = made + 1
    if (size(value) /= size(expected)) then
      failed = failed + 1
      write (error_unit, "(4a)") trim(suite), ": FAILED: ", what, ": sizes differ"
      return
    end if
    if (all(abs(value - expected) <= atol)) return
    failed = failed + 1
    k = maxloc(abs(value - expected), dim=1)
    if (any(value /= value)) k = findloc(value /= value, .true., dim=1)
    write (error_unit, "(4a,i0,a,es24.16,a,es24.16,a,es9.2)") trim(suite), ": FAILED: ", what, ": element ", k, ": got ", &
      value(k), ", expected ", expected(k), ", tolerance ", atol
  end subroutine check_array

  subroutine check_scalar_single(value, expected, atol, what)
    real(sp), intent(in) :: value, expected, atol
    character(len=*), intent(in) :: what
    call check_scalar(real(value, dp), real(expected, dp), real(atol, dp), what)
  end subroutine check_scalar_single

  subroutine check_array_single(value, expected, atol, what)
    real(sp), intent(in) :: value(:), expected(:), atol
    character(len=*), intent(in) :: what
    call check_array(real(value, dp), real(expected, dp), real(atol, dp), what)
  end subroutine check_array_single

  subroutine check_integer(value, expected, what)
    integer, intent(in) :: value, expected
    character(len=*), intent(in) :: what
    made = made + 1
    if (value == expected) return
    failed = failed + 1
    write (error_unit, "(4a,i0,a,i0)") trim(suite), ": FAILED: ", what, ": got ", value, ", expected ", expected
  end subroutine check_integer

  subroutine check_text(value, expected, what)
    character(len=*), intent(in) :: value, expected, what
    made = made + 1
    if (value == expected) return
    failed = failed + 1
    write (error_unit, "(8a)") trim(suite), ": FAILED: ", what, ": got '", value, "', expected '", expected//"'"
  end subroutine check_text

end module gimp_check
