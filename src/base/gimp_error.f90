!> Errors are values: whoever fails hands one back, only the main program ends the run.
module gimp_error
  implicit none(type, external)
  private
  public :: error_t, raise, add_error, report_lines

  !> What went wrong, in words for the author of the scene; several messages are separated by new lines
  type :: error_t
    character(len=:), allocatable :: message
  end type error_t

contains

  !> Make an error; the caller returns right after
  pure subroutine raise(error, message)
    type(error_t), allocatable, intent(out) :: error !! allocated on exit
    character(len=*), intent(in) :: message !! where, what, and what would be right
    allocate (error)
    error%message = message
  end subroutine raise

  !> Collect one more message, so that every mistake can be told in one go
  pure subroutine add_error(error, message)
    type(error_t), allocatable, intent(inout) :: error !! allocated on exit
    character(len=*), intent(in) :: message !! where, what, and what would be right
    if (.not. allocated(error)) then
      allocate (error)
      error%message = message
    else
      error%message = error%message//new_line("a")//message
    end if
  end subroutine add_error

  !> How many messages an error holds
  pure integer function report_lines(error)
    type(error_t), allocatable, intent(in) :: error
    integer :: k
    report_lines = 0
    if (.not. allocated(error)) return
    report_lines = 1
    do k = 1, len(error%message)
      if (error%message(k:k) == new_line("a")) report_lines = report_lines + 1
    end do
  end function report_lines

end module gimp_error
