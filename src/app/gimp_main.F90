!> gimp.x < input.nml: the only place that ends the program. Exit codes: 0 done, 1 the run failed, 2 bad input,
!> 75 stopped early with a checkpoint.
!> All ranks go the same way to the end; the first reads the scene, and only the first says anything.
program gimp_main
  use gimp_kinds, only: dp, precision_word
  use gimp_error, only: error_t, report_lines
  use gimp_text, only: text_of
  use gimp_file_system, only: file_exists
  use gimp_timer, only: seconds_now
  use gimp_signals, only: install_handlers, stops
  use gimp_ranks, only: start_ranks, end_ranks, this_rank
  use gimp_over_ranks, only: share_text, share_error
  use gimp_scene, only: read_input, parse_scene, help_text, group_help, write_reference, text_most
  use gimp_run, only: run_t, prepare, check_only, run_scene
  use gimp_report, only: build_t
  use, intrinsic :: iso_fortran_env, only: error_unit, output_unit
  implicit none(type, external)
  include "gimp_commit.inc"
  type(run_t), allocatable :: run ! on the heap: it is large
  type(build_t) :: build
  real(dp) :: start ! of the program [s]
  type(error_t), allocatable :: error
  character(len=:), allocatable :: text
  character(len=:), allocatable :: restart
  logical :: only_check, failed

  build = build_t(GIMP_VERSION, build_commit, GIMP_BUILD)
  start = seconds_now()
  call start_ranks()
  call read_command_line(only_check, restart)
  allocate (run)
  run%clock%start = start
  if (this_rank == 0) call read_input(text)
  call share_text(0, text)
  call parse_scene(text, run%scene, error, restart)
  call share_error(error) ! files may look different from elsewhere
  if (.not. only_check) call install_handlers() ! not before: who waits for input wants to be stopped at once
  if (.not. allocated(error)) call prepare(run, error)
  if (allocated(error)) call tell_mistakes()
  if (only_check) then
    call check_only(run, build, error, failed)
    if (allocated(error) .and. .not. failed) call tell_mistakes()
    if (failed .and. this_rank == 0) call tell_error(error%message)
    call end_ranks(merge(1, 0, failed))
  end if
  call run_scene(run, build, error, failed)
  if (allocated(error)) then
    if (.not. failed) call tell_mistakes()
    if (this_rank == 0) call tell_failure()
    call end_ranks(1)
  end if
  flush (output_unit) ! mpirun ends all ranks when the first has a code other than 0
  call end_ranks(merge(75, 0, stops(run%stopped_by)))

contains

  !> What is asked for; questions are answered here, and end the program
  subroutine read_command_line(only_check, restart)
    logical, intent(out) :: only_check
    character(len=:), allocatable, intent(out) :: restart !! checkpoint to go on from, empty for none
    character(len=:), allocatable :: word
    integer :: k
    only_check = .false.
    restart = ""
    k = 1
    do while (k <= command_argument_count())
      word = argument(k)
      select case (word)
      case ("--check")
        only_check = .true.
      case ("--restart")
        k = k + 1
        restart = argument(k)
        if (restart == "") call refuse("--restart needs a checkpoint, as in --restart two_disks.checkpoint.h5")
        if (len(restart) > text_most) call refuse("--restart: the path is longer than "//text_of(text_most)//" characters")
      case ("--version", "--help", "--reference")
        if (k == 1) call answer(word, argument(2))
        call refuse(word//" stands alone; gimp.x --help tells how")
      case default
        call refuse("unknown argument '"//word//"'; gimp.x --help tells which there are")
      end select
      k = k + 1
    end do
  end subroutine read_command_line

  function argument(k) result(word)
    integer, intent(in) :: k
    character(len=:), allocatable :: word
    integer :: length
    call get_command_argument(k, length=length)
    allocate (character(len=length) :: word)
    if (length > 0) call get_command_argument(k, word)
  end function argument

  !> Print what was asked for, once, and end
  subroutine answer(question, about)
    character(len=*), intent(in) :: question, about
    if (command_argument_count() > merge(2, 1, question == "--help")) return
    select case (question)
    case ("--version")
      text = "gimp.x "//trim(build%version)//" ("//trim(build%commit)//", "//trim(build%kind)//", "//precision_word//" precision)"
    case ("--reference")
      if (this_rank == 0) call write_reference(output_unit)
    case default
      if (about == "") then
        call help_text(text)
      else
        call group_help(about, text, error)
        if (allocated(error)) call refuse(error%message)
      end if
    end select
    if (this_rank == 0 .and. allocated(text)) write (output_unit, "(a)") text
    flush (output_unit)
    call end_ranks(0)
  end subroutine answer

  !> Every mistake of the scene, and exit code 2
  subroutine tell_mistakes()
    integer :: n, i, from
    if (this_rank > 0) call end_ranks(2)
    flush (output_unit)
    n = report_lines(error)
    write (error_unit, "(a)") "gimp.x: "//text_of(n)//trim(merge(" mistake ", " mistakes", n == 1))//" in the scene"
    from = 1
    do i = 1, len(error%message)
      if (error%message(i:i) /= new_line("a")) cycle
      write (error_unit, "(a)") "  "//error%message(from:i - 1)
      from = i + 1
    end do
    write (error_unit, "(a)") "  "//error%message(from:)
    call end_ranks(2)
  end subroutine tell_mistakes

  !> What went wrong and where to look: only what is really there
  subroutine tell_failure()
    call tell_error("the run failed: "//error%message)
    if (file_exists(run%recorder%path)) then
      write (error_unit, "(a)") "  committed frames are in "//run%recorder%path
    else
      write (error_unit, "(a)") "  no frame was committed"
    end if
    if (run%has_failed_state) then
      write (error_unit, "(a)") "  the failed state is in "//run%recorder%name//".failed.h5"
    else
      write (error_unit, "(a)") "  the failed state could not be written"
    end if
  end subroutine tell_failure

  !> After all that was said before
  subroutine tell_error(message)
    character(len=*), intent(in) :: message
    flush (output_unit)
    write (error_unit, "(a)") "gimp.x: "//message
  end subroutine tell_error

  !> A command line that is not understood
  subroutine refuse(message)
    character(len=*), intent(in) :: message
    if (this_rank == 0) call tell_error(message)
    call end_ranks(2)
  end subroutine refuse

end program gimp_main
