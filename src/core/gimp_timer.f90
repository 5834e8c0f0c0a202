!> Wall-clock time of the phases of a run
module gimp_timer
  use gimp_kinds, only: dp, i8
  implicit none(type, external)
  private
  public :: seconds_now, timer_t, max_phases, phase_of

  integer, parameter :: max_phases = 16

  !> Named phases with the seconds spent in each
  type :: timer_t
    integer :: n = 0
    character(len=16) :: name(max_phases) = ""
    real(dp) :: seconds(max_phases) = 0.0_dp
  end type timer_t

contains

  !> Seconds of a monotonic clock
  real(dp) function seconds_now()
    integer(i8) :: count, rate
    call system_clock(count, rate)
    seconds_now = real(count, dp)/real(rate, dp)
  end function seconds_now

  !> Index of a phase by name; made when new
  integer function phase_of(timer, name) result(k)
    type(timer_t), intent(inout) :: timer
    character(len=*), intent(in) :: name
    do k = 1, timer%n
      if (timer%name(k) == name) return
    end do
    timer%n = timer%n + 1
    k = timer%n
    timer%name(k) = name
  end function phase_of

end module gimp_timer
