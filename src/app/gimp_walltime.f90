!> The wall-clock limit of a run: when it must stop so that there is time left for a checkpoint.
module gimp_walltime
  use gimp_kinds, only: dp, i8
  use gimp_timer, only: seconds_now
  implicit none(type, external)
  private
  public :: walltime_t, start_walltime, note_step, note_checkpoint, time_is_up, reserve_of

  real(dp), parameter :: slow_disk = 100.0e6_dp !! bytes a second that any disk can be trusted with
  real(dp), parameter :: margin = 0.05_dp, largest_margin = 60.0_dp !! share of the limit, [s]

  !> The clock of a run, in seconds
  type :: walltime_t
    real(dp) :: start = 0.0_dp !! of the program
    real(dp) :: limit = 0.0_dp !! 0: none
    real(dp) :: last = 0.0_dp !! when the last step ended
    real(dp) :: step = 0.0_dp !! the longest step so far, with what it wrote
    real(dp) :: checkpoint = 0.0_dp !! what one takes: a guess, until one was written
  end type walltime_t

contains

  !> Set the limit; the run is ready for its first step
  subroutine start_walltime(clock, limit, bytes)
    type(walltime_t), intent(inout) :: clock !! its `start` was set when the program began
    real(dp), intent(in) :: limit !! [s]; 0: none
    integer(i8), intent(in) :: bytes !! of a checkpoint, roughly
    clock%limit = limit
    clock%last = seconds_now()
    clock%checkpoint = real(bytes, dp)/slow_disk
  end subroutine start_walltime

  !> A step is over, with all that was written after it
  subroutine note_step(clock)
    type(walltime_t), intent(inout) :: clock
    real(dp) :: now
    now = seconds_now()
    clock%step = max(clock%step, now - clock%last)
    clock%last = now
  end subroutine note_step

  !> A checkpoint took so long
  subroutine note_checkpoint(clock, seconds)
    type(walltime_t), intent(inout) :: clock
    real(dp), intent(in) :: seconds
    clock%checkpoint = seconds
  end subroutine note_checkpoint

  !> Seconds to keep for a checkpoint: twice what the last one took, and two steps, as disks and nodes are shared with others
  pure real(dp) function reserve_of(clock) result(seconds)
    type(walltime_t), intent(in) :: clock
    seconds = 2.0_dp*(clock%checkpoint + clock%step) + min(largest_margin, margin*clock%limit)
  end function reserve_of

  !> Whether it is time to write a checkpoint and stop. Clocks differ: ranks must agree
  logical function time_is_up(clock)
    type(walltime_t), intent(in) :: clock
    time_is_up = .false.
    if (clock%limit > 0.0_dp) time_is_up = seconds_now() - clock%start > clock%limit - reserve_of(clock)
  end function time_is_up

end module gimp_walltime
