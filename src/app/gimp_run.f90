!> A run from a checked scene to its closing table
module gimp_run
  use gimp_kinds, only: dp, i8
  use gimp_error, only: error_t, add_error
  use gimp_text, only: text_of
  use gimp_timer, only: seconds_now
  use gimp_ranks, only: this_rank
  use gimp_over_ranks, only: share_error, any_rank, sum_counts
  use gimp_scene, only: scene_t, count_groups, word_of, text_of_key, reals_of, complain
  use gimp_file_system, only: folder_of, folder_writable
  use gimp_verification, only: verification_t
  use gimp_measures, only: nearest_particle
  use gimp_loads, only: load_point
  use gimp_run_state, only: stepper_t, stepper_bytes
  use gimp_stepper, only: start_run, plan_step, take_step
  use gimp_setup_sides, only: is_on_particles
  use gimp_setup, only: set_up_scene, set_up_threads, body_named
  use gimp_population, only: population_t, count_particles
  use gimp_populate, only: populate
  use gimp_recorder, only: recorder_t, open_recorder, record_frame, record_row, close_recorder, record_failure, next_frame_time, &
    continue_record
  use gimp_ranks_report, only: together_t, measure_together
  use gimp_report, only: build_t, progress_t, costs_t, whole_t, measure_whole, hash_text, print_header, start_progress, &
    show_progress, end_progress, print_closing, write_closing, print_going_on, tell_checkpoint
  use gimp_signals, only: wish_here, forget_checkpoint, wish_words, wish_none, wish_checkpoint, wish_walltime, stops
  use gimp_walltime, only: walltime_t, start_walltime, note_step, note_checkpoint, time_is_up, reserve_of
  use gimp_forecast, only: tell_forecast
  use gimp_restart, only: restart_t, set_up_restart, check_checkpoint, load_checkpoint, start_checkpoints, checkpoint_due, &
    write_checkpoint, continued_words
  use, intrinsic :: iso_fortran_env, only: output_unit
  implicit none(type, external)
  private
  public :: run_t, prepare, check_only, run_scene

  !> Everything a run holds
  type :: run_t
    type(scene_t) :: scene
    type(stepper_t) :: stepper
    type(verification_t) :: solution
    type(recorder_t) :: recorder
    type(restart_t) :: restart
    type(costs_t) :: costs
    type(walltime_t) :: clock
    integer(i8), allocatable :: body_first(:)
    logical :: has_failed_state = .false. !! NAME.failed.h5 was written; a full disk may prevent it
    integer :: stopped_by = wish_none !! who ended the run early, with a checkpoint
  end type run_t

contains

  !> Set the run up as far as bad input can matter; all mistakes are told at once. Collective, and so is all that follows: each
  !> part that may fail on one rank alone ends with the ranks agreeing about it
  subroutine prepare(run, error)
    type(run_t), intent(inout) :: run
    type(error_t), allocatable, intent(out) :: error
    type(population_t) :: population
    type(error_t), allocatable :: problem
    real(dp) :: start
    start = seconds_now()
    call set_up_threads(run%scene, run%costs%threads)
    call set_up_scene(run%scene, run%stepper, run%solution, error)
    if (allocated(run%stepper%engine%laws)) then
      call count_particles(run%scene, run%stepper, population, problem)
      if (allocated(problem)) call add_error(error, problem%message)
    end if
    if (this_rank == 0) call check_folder(run%scene, error)
    call set_up_restart(run%scene, run%stepper, run%restart)
    call check_checkpoint(run%restart, run%scene, error)
    call share_error(error)
    if (allocated(error)) return
    call populate(run%scene, run%stepper, run%solution, population, error)
    call share_error(error)
    if (allocated(error)) return
    run%body_first = population%first
    call place_point_loads(run, population, error)
    call share_error(error)
    if (allocated(error)) return
    if (is_continued(run)) &
      call load_checkpoint(run%restart, run%scene, run%stepper, run%solution, run%body_first, run%recorder, run%costs, error)
    call share_error(error)
    if (allocated(error)) return
    run%stepper%engine%particles%n_all = sum_counts(run%stepper%engine%particles%n)
    call start_walltime(run%clock, run%restart%max_seconds, stepper_bytes(run%stepper))
    call check_walltime(run, error)
    call share_error(error)
    run%costs%steps_before = run%stepper%step
    run%costs%setup = seconds_now() - start
  end subroutine prepare

  !> A limit that stops a run before its first step would have a queue start it again for ever
  subroutine check_walltime(run, error)
    type(run_t), intent(in) :: run
    type(error_t), allocatable, intent(inout) :: error
    if (time_is_up(run%clock)) call complain(error, run%scene, "restart", 1, "max_walltime", "leaves no time for a step after " &
      //"the set-up, with "//text_of(reserve_of(run%clock), 2)//" s kept for a checkpoint")
  end subroutine check_walltime

  !> Whether the run goes on from a checkpoint
  pure logical function is_continued(run)
    type(run_t), intent(in) :: run
    is_continued = run%restart%from /= ""
  end function is_continued

  !> Better told now than after the particles are made
  subroutine check_folder(scene, error)
    type(scene_t), intent(in) :: scene
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: folder
    folder = folder_of(text_of_key(scene, "output", 1, "name"))
    if (.not. folder_writable(folder)) &
      call complain(error, scene, "output", 1, "name", "no file can be made in the folder "//folder)
  end subroutine check_folder

  !> A point force acts on the particle of its body that is nearest to the point
  subroutine place_point_loads(run, population, error)
    type(run_t), intent(inout) :: run
    type(population_t), intent(in) :: population
    type(error_t), allocatable, intent(inout) :: error
    integer :: k, n, b
    n = 0
    do k = 1, count_groups(run%scene, "load")
      if (.not. is_on_particles(run%scene, k)) cycle
      n = n + 1
      if (run%stepper%loads%load(n)%kind /= load_point) cycle
      b = body_named(run%scene, text_of_key(run%scene, "load", k, "body"))
      run%stepper%loads%load(n)%id = nearest_particle(run%stepper%engine, reals_of(run%scene, "load", k, "point"), &
                                                      population%first(b), population%first(b) + population%count(b) - 1)
      if (run%stepper%loads%load(n)%id == 0) call complain(error, run%scene, "load", k, "body", "the body has no particles")
    end do
  end subroutine place_point_loads

  !> `--check`: what the run would be and cost. Nothing is written
  subroutine check_only(run, build, error, failed)
    type(run_t), intent(inout) :: run
    type(build_t), intent(in) :: build
    type(error_t), allocatable, intent(out) :: error
    logical, intent(out) :: failed !! it is a step that went wrong
    failed = .false.
    if (.not. is_continued(run)) call start_run(run%stepper, error)
    call share_error(error)
    if (allocated(error)) return
    call print_header(build, run%scene, run%stepper, run%costs%threads, continued_words(run%restart, run%stepper))
    call tell_forecast(run%scene, run%stepper, error)
    failed = allocated(error)
    if (this_rank == 0 .and. .not. failed) write (output_unit, "(a)") "  checked: the scene is sound; nothing was written"
  end subroutine check_only

  !> Run to the end. `failed` tells a run that went wrong from a problem before it started.
  subroutine run_scene(run, build, error, failed)
    type(run_t), intent(inout) :: run
    type(build_t), intent(in) :: build
    type(error_t), allocatable, intent(out) :: error
    logical, intent(out) :: failed !! the run had begun: its output holds what was committed
    type(progress_t) :: progress
    type(error_t), allocatable :: ignored
    type(whole_t) :: whole
    type(together_t) :: together
    character(len=:), allocatable :: status
    real(dp) :: start
    failed = .false.
    start = seconds_now()
    if (.not. is_continued(run)) call start_run(run%stepper, error)
    call share_error(error)
    if (allocated(error)) return
    call print_header(build, run%scene, run%stepper, run%costs%threads, continued_words(run%restart, run%stepper))
    failed = .true.
    if (is_continued(run)) then
      call continue_record(run%recorder, run%stepper%step, run%restart%lineage, error)
    else
      call open_recorder(run%scene, run%stepper, run%solution, run%body_first, run%recorder, error)
      run%stepper%seconds = 0.0_dp
    end if
    call share_error(error)
    if (allocated(error)) return
    run%costs%setup = run%costs%setup + seconds_now() - start
    call start_progress(progress, word_of(run%scene, "output", 1, "progress"), run%stepper)
    call step_to_end(run, progress, status, error)
    call end_progress(progress)
    call measure_whole(run%stepper, whole)
    whole%hash = hash_text(run%stepper)
    call measure_together(run%stepper, together)
    if (allocated(error)) then
      call record_failure(run%recorder, run%stepper, error%message, ignored)
      run%has_failed_state = .not. any_rank(allocated(ignored))
      call write_closing(build, run%stepper, whole, together, run%recorder, run%costs, "failed", ignored)
      call close_recorder(run%recorder, ignored)
      return
    end if
    call write_closing(build, run%stepper, whole, together, run%recorder, run%costs, status, error)
    call share_error(error)
    if (.not. allocated(error)) call close_recorder(run%recorder, error)
    call share_error(error)
    if (allocated(error)) return
    call print_closing(run%stepper, whole, together, run%recorder, run%costs, status)
    if (stops(run%stopped_by)) call print_going_on(run%restart%name, wish_words(run%stopped_by))
    failed = .false.
  end subroutine run_scene

  !> The time loop
  subroutine step_to_end(run, progress, status, error)
    type(run_t), intent(inout) :: run
    type(progress_t), intent(inout) :: progress
    character(len=:), allocatable, intent(out) :: status
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: start
    real(dp) :: until
    integer :: wish
    associate (s => run%stepper, end => run%stepper%time_options%end)
      status = "done"
      if (.not. is_continued(run)) call record(run, frame=.true., row=.true., error=error)
      if (allocated(error)) return
      call start_checkpoints(run%restart, s)
      wish = wish_here()
      call share_error(error, wish)
      do while (end - s%time > 1.0e-9_dp*max(s%dt, tiny(1.0_dp)))
        if (s%time_options%max_steps > 0 .and. s%step >= s%time_options%max_steps) then
          status = "max_steps"
          exit
        end if
        if (stops(wish)) then
          status = "stopped"
          run%stopped_by = wish
          exit
        end if
        start = seconds_now()
        until = next_frame_time(run%recorder, end) - s%time
        if (until <= 0.0_dp) until = end - s%time
        call plan_step(s, until, error) ! by numbers that all ranks have: all of them fail or none
        if (allocated(error)) return
        call take_step(s, error)
        wish = wish_now(run)
        call share_error(error, wish)
        if (allocated(error)) return
        run%costs%stepping = run%costs%stepping + seconds_now() - start
        run%costs%dt_min = min(run%costs%dt_min, s%dt)
        run%costs%dt_max = max(run%costs%dt_max, s%dt)
        run%costs%limited(s%limit) = run%costs%limited(s%limit) + 1
        call record(run, frame=s%time >= next_frame_time(run%recorder, end) - 1.0e-9_dp*s%dt, &
                    row=modulo(s%step, int(run%recorder%history_every, i8)) == 0, error=error)
        if (allocated(error)) return
        if (wish == wish_checkpoint) call keep_state(run, progress, error)
        if (allocated(error)) return
        call show_progress(progress, s)
        call note_step(run%clock)
      end do
      call end_record(run, progress, status, error)
    end associate
  end subroutine step_to_end

  !> What this rank wishes after a step; ranks then take the strongest wish of all
  integer function wish_now(run) result(wish)
    type(run_t), intent(in) :: run
    wish = wish_here()
    if (time_is_up(run%clock)) wish = max(wish, wish_walltime)
    if (checkpoint_due(run%restart, run%stepper)) wish = max(wish, wish_checkpoint)
  end function wish_now

  !> The last checkpoint, and then the frame that the end of the run asks for: a run that goes on has no frame here. One that was
  !> told to stop leaves it out, as time may be short
  subroutine end_record(run, progress, status, error)
    type(run_t), intent(inout) :: run
    type(progress_t), intent(inout) :: progress
    character(len=*), intent(in) :: status
    type(error_t), allocatable, intent(out) :: error
    logical :: stopped
    stopped = status == "stopped"
    if ((run%restart%asked .or. stopped) .and. run%restart%last_step /= run%stepper%step) call keep_state(run, progress, error)
    if (allocated(error)) return
    call record(run, frame=.not. stopped, row=.true., error=error)
  end subroutine end_record

  !> Write a row and a frame where they are due; a frame always has its row
  subroutine record(run, frame, row, error)
    type(run_t), intent(inout) :: run
    logical, intent(in) :: frame, row
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: start
    if (.not. (frame .or. row)) return
    start = seconds_now()
    call record_row(run%recorder, run%stepper, error)
    call share_error(error)
    if (frame .and. .not. allocated(error)) call record_frame(run%recorder, run%stepper, error)
    call share_error(error)
    run%costs%output = run%costs%output + seconds_now() - start
  end subroutine record

  !> Write a checkpoint
  subroutine keep_state(run, progress, error)
    type(run_t), intent(inout) :: run
    type(progress_t), intent(in) :: progress
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: start, seconds
    start = seconds_now()
    call write_checkpoint(run%restart, run%stepper, run%recorder, run%costs, error)
    call share_error(error)
    seconds = seconds_now() - start
    run%costs%output = run%costs%output + seconds
    call forget_checkpoint()
    call note_checkpoint(run%clock, seconds)
    if (.not. allocated(error)) call tell_checkpoint(progress, run%stepper, run%restart%name, seconds)
  end subroutine keep_state

end module gimp_run
