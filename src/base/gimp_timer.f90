!> Wall-clock time
module gimp_timer
  use gimp_common_kinds, only: dp, i8
  implicit none(type, external)
  private
  public :: seconds_now

contains

  !> Seconds of a monotonic clock
  real(dp) function seconds_now()
    integer(i8) :: count, rate
    call system_clock(count, rate)
    seconds_now = real(count, dp)/real(rate, dp)
  end function seconds_now

end module gimp_timer
