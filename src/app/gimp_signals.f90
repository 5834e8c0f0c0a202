!> Signals: how a batch queue, or somebody at a terminal, asks a run for a checkpoint or for its end.
!>
!> USR1: write a checkpoint and go on. USR2, TERM and INT: write one and stop, so that the run can go on later; a second INT ends the
!> program at once. A handler only notes what was asked for. The time loop looks once a step, and all ranks decide together, as a
!> signal may reach only some of them.
module gimp_signals
  use, intrinsic :: iso_c_binding, only: c_int, c_funptr, c_funloc, c_null_funptr
  implicit none(type, external)
  private
  public :: install_handlers, wish_here, forget_checkpoint, wish_words, stops, wish_none, wish_checkpoint, wish_walltime

  integer(c_int), parameter :: sigint = 2, sigusr1 = 10, sigusr2 = 12, sigterm = 15 !! numbers of Linux
  !> What is wished of a run, the stronger the larger; a signal that stops it is `wish_stop` plus its number
  integer, parameter :: wish_none = 0, wish_checkpoint = 1, wish_walltime = 2, wish_stop = 100

  integer(c_int), volatile :: checkpoint_asked = 0 !! set by handlers
  integer(c_int), volatile :: stop_asked = 0 !! 0, or the signal's number

  interface
    function c_signal(number, handler) bind(c, name="signal") result(before)
      import :: c_int, c_funptr
      implicit none(type, external)
      integer(c_int), value :: number
      type(c_funptr), value :: handler
      type(c_funptr) :: before
    end function c_signal
  end interface

contains

  !> From now on signals are wishes. After `start_ranks`: MPI libraries install handlers of their own
  subroutine install_handlers()
    integer(c_int), parameter :: caught(4) = [sigusr1, sigusr2, sigterm, sigint]
    type(c_funptr) :: before
    integer :: k
    do k = 1, size(caught)
      before = c_signal(caught(k), c_funloc(note_signal))
    end do
  end subroutine install_handlers

  !> The handler: nothing but stores and a call that is safe in one
  subroutine note_signal(number) bind(c)
    integer(c_int), value :: number
    type(c_funptr) :: before
    if (number == sigusr1) then
      checkpoint_asked = 1
    else
      stop_asked = number
    end if
    if (number == sigint) before = c_signal(sigint, c_null_funptr) ! the default, which ends the program
  end subroutine note_signal

  !> What signals asked this rank for
  integer function wish_here() result(wish)
    wish = wish_none
    if (checkpoint_asked /= 0) wish = wish_checkpoint
    if (stop_asked /= 0) wish = wish_stop + int(stop_asked)
  end function wish_here

  !> A checkpoint was written. Ranks may see a signal some steps apart: those to whom it came later need no second one
  subroutine forget_checkpoint()
    checkpoint_asked = 0
  end subroutine forget_checkpoint

  !> Whether a wish ends the run
  pure logical function stops(wish)
    integer, intent(in) :: wish
    stops = wish > wish_checkpoint
  end function stops

  !> Who wished that a run stops, in words
  function wish_words(wish) result(words)
    integer, intent(in) :: wish
    character(len=:), allocatable :: words
    select case (wish - wish_stop)
    case (sigint); words = "signal INT"
    case (sigterm); words = "signal TERM"
    case (sigusr2); words = "signal USR2"
    case default; words = "max_walltime"
    end select
  end function wish_words

end module gimp_signals
