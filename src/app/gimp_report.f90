!> What a run says on the terminal: header, progress and the closing table, with the same numbers in the output file.
!> All ranks measure, the first one speaks.
module gimp_report
  use gimp_kinds, only: dp, i8, precision_word
  use gimp_error, only: error_t
  use gimp_text, only: text_of, with_thousands, short_number
  use gimp_timer, only: seconds_now
  use gimp_ranks, only: this_rank, ranks
  use gimp_over_ranks, only: sum_counts, largest_count
  use gimp_scene, only: scene_t, count_groups, text_of_key, word_of
  use gimp_engine, only: least_spacing, engine_bytes
  use gimp_particles, only: live_bytes, field_t
  use gimp_summary, only: put_summary
  use gimp_mesh_report, only: tell_mesh, mesh_bytes, search_words, write_mesh_summary, particles_put_back, points_beyond
  use gimp_ranks_report, only: together_t, together_words, write_together
  use gimp_checkpoint, only: newest_path
  use gimp_verification, only: error_scale, error_scale_text, solution_name
  use gimp_measures, only: state_hash
  use gimp_books, only: energy_residual, energy_drift, momentum_residual
  use gimp_run_state, only: stepper_t, stepper_bytes, series_none, phase_grid, phase_particles, phase_sort, phase_checks
  use gimp_step_size, only: limit_word, rule_adaptive, n_limits
  use gimp_stability, only: check_none, check_word
  use gimp_recorder, only: recorder_t
  use, intrinsic :: iso_fortran_env, only: output_unit, compiler_version
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none(type, external)
  private
  public :: build_t, progress_t, whole_t, measure_whole, hash_text, print_header, start_progress, show_progress, end_progress, &
    tell_checkpoint, print_closing, print_going_on, write_closing, estimated_steps, usual_step, share_done

  !> How the executable was built
  type :: build_t
    character(len=32) :: version = "", commit = "", kind = ""
  end type build_t

  real(dp), parameter :: burst = 0.5_dp !! energy drift above which a finished run has little to do with its scene
  real(dp), parameter :: adrift = 0.01_dp !! the same for momentum lost on nodes without mass, of the largest of the bodies

  !> The progress line
  type :: progress_t
    logical :: shown = .false.
    logical :: terminal = .false. !! one line that is written over, instead of a line now and then
    real(dp) :: start = 0.0_dp, last = 0.0_dp !! [s]
    real(dp) :: share = 0.0_dp !! of the run that was done at the start
    integer(i8) :: particle_steps = 0 !! done at the start
  end type progress_t

  !> What the steps cost, for the closing table
  type, public :: costs_t
    real(dp) :: stepping = 0.0_dp, output = 0.0_dp, setup = 0.0_dp !! [s]
    real(dp) :: dt_min = huge(1.0_dp), dt_max = 0.0_dp !! [s]
    integer(i8) :: limited(n_limits) = 0 !! steps by limit
    integer :: threads = 1
    integer(i8) :: steps_before = 0 !! of runs that this one continues
  end type costs_t

  !> What all ranks hold together
  type :: whole_t
    integer(i8) :: particles = 0, blocks = 0
    integer(i8) :: bytes = 0 !! of particles, grid, sort and the state that steps are redone from
    integer(i8) :: most_bytes = 0 !! of the rank that has most
    character(len=16) :: hash = "" !! of the state; set by who needs it, it takes a while
  end type whole_t

  interface
    function c_isatty(descriptor) bind(c, name="isatty") result(answer)
      import :: c_int
      implicit none(type, external)
      integer(c_int), value :: descriptor
      integer(c_int) :: answer
    end function c_isatty
  end interface

contains

  !> Length of a step [s], from the speeds at the start; a guess for adaptive steps
  pure real(dp) function usual_step(s) result(step)
    type(stepper_t), intent(in) :: s
    associate (t => s%time_options)
      step = t%step
      if (t%rule == rule_adaptive) step = min(t%end, t%courant*least_spacing(s%engine)/max(s%rate, tiny(1.0_dp)))
    end associate
  end function usual_step

  !> Steps that a run will take
  pure real(dp) function estimated_steps(s) result(steps)
    type(stepper_t), intent(in) :: s
    steps = s%time_options%end/usual_step(s)
    if (s%time_options%max_steps > 0) steps = min(steps, real(s%time_options%max_steps, dp))
  end function estimated_steps

  !> Measure the whole. Collective
  subroutine measure_whole(s, whole)
    type(stepper_t), intent(in) :: s
    type(whole_t), intent(out) :: whole
    whole%particles = sum_counts(s%engine%particles%n)
    whole%blocks = sum_counts(int(s%engine%table%blocks, i8))
    whole%bytes = sum_counts(stepper_bytes(s) + mesh_bytes(s%engine))
    whole%most_bytes = largest_count(stepper_bytes(s) + mesh_bytes(s%engine))
  end subroutine measure_whole

  !> Hash of the state in figures and letters. Collective
  function hash_text(s) result(text)
    type(stepper_t), intent(in) :: s
    character(len=16) :: text
    write (text, "(z16.16)") state_hash(s%engine, s%step, s%time)
  end function hash_text

  !> Version, scene in words, and what the run will cost. Collective
  subroutine print_header(build, scene, s, threads, continued)
    type(build_t), intent(in) :: build
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in) :: s
    integer, intent(in) :: threads !! of each rank
    character(len=*), intent(in) :: continued !! what the run goes on from, in words; empty: it starts anew
    character(len=:), allocatable :: cells
    type(whole_t) :: whole
    integer :: k
    call measure_whole(s, whole)
    if (this_rank > 0) return
    cells = text_of(s%engine%grid%cells(1))
    do k = 2, scene%dimension
      cells = cells//" x "//text_of(s%engine%grid%cells(k))
    end do
    call line("gimp.x "//trim(build%version)//" ("//trim(build%commit)//", "//trim(build%kind)//", "//precision_word//" precision)")
    if (text_of_key(scene, "scene", 1, "title") /= "") call line("  "//text_of_key(scene, "scene", 1, "title"))
    if (continued /= "") call line("  continued "//continued)
    if (s%engine%grid%is_mesh) then
      call tell_mesh(s%engine, s%walls, text_of_key(scene, "mesh", 1, "file"))
    else
      call line("  grid       "//cells//" cells of "//text_of(s%engine%grid%spacing)//" m")
    end if
    call line("  material   "//material_words())
    call line("  particles  "//with_thousands(whole%particles)//" in " &
              //plural(count_groups(scene, "body"), "body", "bodies")//", " &
              //block_words())
    call line("  method     "//word_of(scene, "method", 1, "basis")//", "//word_of(scene, "method", 1, "stress_update")//", " &
              //transfer_words()//", "//word_of(scene, "method", 1, "deformation_update")//" F")
    call line("  stored     "//text_of(live_bytes(s%engine%particles))//" bytes a particle: "//always_stored())
    do k = 1, size(s%engine%particles%fields)
      if (s%engine%particles%fields(k)%reason /= "") call line("             "//field_words(s%engine%particles%fields(k)) &
        //" ("//trim(s%engine%particles%fields(k)%reason)//")")
    end do
    call line("  memory     "//short_number(real(whole%bytes, dp))//"B, " &
              //text_of(int(whole%bytes/max(1_i8, whole%particles)))//" bytes a particle with "//merge("mesh", "grid", s%engine%grid%is_mesh)//" and sort"//saved_words())
    if (ranks > 1) call line("  ranks      "//text_of(ranks)//" of "//plural(threads, "thread", "threads") &
                             //"; the fullest holds "//short_number(real(whole%most_bytes, dp))//"B")
    call line("  time       "//text_of(s%time_options%end)//" s in about "//with_thousands(ceiling(estimated_steps(s), i8)) &
              //" steps of "//text_of(usual_step(s), 3)//" s")
    flush (output_unit)

  contains

    function block_words() result(words)
      character(len=:), allocatable :: words
      words = plural(int(whole%blocks), "active block of 64 nodes", "active blocks of 64 nodes")
      if (s%engine%grid%is_mesh) words = plural(int(whole%blocks), "patch", "patches")
    end function block_words

    function material_words() result(words)
      character(len=:), allocatable :: words
      integer :: m
      words = ""
      do m = 1, size(s%engine%laws)
        if (m > 1) words = words//"; "
        words = words//trim(s%engine%laws(m)%law%name)//" ("//trim(s%engine%laws(m)%law%model)//", wave speed " &
                //text_of(s%engine%laws(m)%law%initial_speed(), 4)//" m/s)"
      end do
    end function material_words

    !> What every scene stores, with its size
    function always_stored() result(words)
      character(len=:), allocatable :: words
      integer :: f
      words = "number "//text_of(storage_size(1_i8)/8)//" B"
      do f = 1, size(s%engine%particles%fields)
        if (s%engine%particles%fields(f)%reason == "") words = words//", "//field_words(s%engine%particles%fields(f))
      end do
    end function always_stored

    !> Name and bytes of a field
    function field_words(field) result(words)
      type(field_t), intent(in) :: field
      character(len=:), allocatable :: words
      words = trim(field%name)//" "//text_of(field%components*(storage_size(1.0_dp)/8))//" B"
    end function field_words

    !> What redoing steps costs
    function saved_words() result(words)
      character(len=:), allocatable :: words
      words = ""
      if (s%time_options%redo) words = "; "//short_number(real(stepper_bytes(s) - engine_bytes(s%engine), dp)) &
                                       //"B of it the state that steps are redone from"
    end function saved_words

    function transfer_words() result(words)
      character(len=:), allocatable :: words
      words = word_of(scene, "method", 1, "transfer")
      if (s%method%series /= series_none) words = words//"("//text_of(s%method%order)//")"
      if (s%method%series_every > 1) words = words//" every "//text_of(s%method%series_every)//" steps"
      if (words == "flip" .and. s%method%flip < 1.0_dp) words = words//" "//text_of(s%method%flip)
    end function transfer_words

  end subroutine print_header

  function plural(n, one, many) result(words)
    integer, intent(in) :: n
    character(len=*), intent(in) :: one, many
    character(len=:), allocatable :: words
    if (n == 1) then
      words = "1 "//one
    else
      words = with_thousands(int(n, i8))//" "//many
    end if
  end function plural

  !> Decide how progress is shown
  subroutine start_progress(progress, word, s)
    type(progress_t), intent(out) :: progress
    character(len=*), intent(in) :: word !! auto, on, off
    type(stepper_t), intent(in) :: s
    progress%terminal = c_isatty(1_c_int) == 1
    if (word == "on" .or. ranks > 1) progress%terminal = .false. ! plain lines wherever the output goes: launchers show a terminal to ranks that may be a log
    progress%shown = word /= "off"
    progress%start = seconds_now()
    progress%last = progress%start
    progress%share = share_done(s)
    progress%particle_steps = s%particle_steps
  end subroutine start_progress

  !> How much of the run is done, by time or by steps
  pure real(dp) function share_done(s) result(share)
    type(stepper_t), intent(in) :: s
    share = s%time/s%time_options%end
    if (s%time_options%max_steps > 0) share = max(share, real(s%step, dp)/s%time_options%max_steps)
  end function share_done

  !> Percent, rate and time left: often on a terminal, every ten seconds in a log
  subroutine show_progress(progress, s)
    type(progress_t), intent(inout) :: progress
    type(stepper_t), intent(in) :: s
    character(len=:), allocatable :: text
    real(dp) :: now, share, left
    if (.not. progress%shown .or. this_rank > 0) return
    now = seconds_now()
    if (now - progress%last < merge(0.2_dp, 10.0_dp, progress%terminal)) return
    progress%last = now
    share = share_done(s)
    left = (now - progress%start)*(1.0_dp - share)/max(share - progress%share, 1.0e-9_dp)
    text = "  "//text_of(int(100.0_dp*share))//" %  t = "//text_of(s%time, 4)//" s  step "//with_thousands(s%step)//"  " &
           //short_number((s%particle_steps - progress%particle_steps)/max(now - progress%start, 1.0e-9_dp))//"particle-steps/s  " &
           //text_of(ceiling(left))//" s left"
    if (progress%terminal) then
      write (output_unit, "(3a)", advance="no") achar(13), text, repeat(" ", max(0, 78 - len(text)))
    else
      write (output_unit, "(a)") text
    end if
    flush (output_unit)
  end subroutine show_progress

  !> A line in the log for a checkpoint that was written
  subroutine tell_checkpoint(progress, s, name, seconds)
    type(progress_t), intent(in) :: progress
    type(stepper_t), intent(in) :: s
    character(len=*), intent(in) :: name !! of the output
    real(dp), intent(in) :: seconds !! it took
    if (.not. progress%shown .or. progress%terminal .or. this_rank > 0) return
    call line("  checkpoint at step "//with_thousands(s%step)//", t = "//text_of(s%time, 4)//" s, in "//newest_path(name) &
              //" after "//text_of(seconds, 2)//" s")
    flush (output_unit)
  end subroutine tell_checkpoint

  !> Leave the progress line
  subroutine end_progress(progress)
    type(progress_t), intent(in) :: progress
    if (this_rank > 0) return
    if (progress%shown .and. progress%terminal) write (output_unit, "(3a)", advance="no") achar(13), repeat(" ", 78), achar(13)
    flush (output_unit)
  end subroutine end_progress

  !> Speed with error: the table every run ends with
  subroutine print_closing(s, whole, together, recorder, costs, status)
    type(stepper_t), intent(in) :: s
    type(together_t), intent(in) :: together
    type(whole_t), intent(in) :: whole
    type(recorder_t), intent(in) :: recorder
    type(costs_t), intent(in) :: costs
    character(len=*), intent(in) :: status
    real(dp) :: rate, grid, particles, sorting
    integer :: k
    character(len=:), allocatable :: limits
    if (this_rank > 0) return
    rate = s%particle_steps/max(costs%stepping, 1.0e-9_dp)
    grid = 100.0_dp*s%seconds(phase_grid)/max(costs%stepping, 1.0e-9_dp)
    particles = 100.0_dp*s%seconds(phase_particles)/max(costs%stepping, 1.0e-9_dp)
    sorting = 100.0_dp*s%seconds(phase_sort)/max(costs%stepping, 1.0e-9_dp)
    limits = ""
    do k = 1, size(costs%limited)
      if (costs%limited(k) > 0) limits = limits//", "//limit_word(k)//" " &
        //text_of(nint(100.0_dp*costs%limited(k)/max(1_i8, s%step)))//" %"
    end do
    call line("")
    call line("  status             "//status//" at t = "//text_of(s%time)//" s after "//with_thousands(s%step)//" steps")
    if (s%step > 0) call line("  step               "//text_of(costs%dt_min, 3)//" to "//text_of(costs%dt_max, 3)//" s" &
                              //"; set by "//limits(3:))
    if (s%time_options%check /= check_none .and. s%step > 0) &
      call line("  critical step      "//text_of(s%least_critical, 3)//" s at least; steps up to "//text_of(s%critical_share, 3) &
                //" of it ("//check_word(s%time_options%check)//", every "//plural(s%time_options%check_every, "step", "steps")//")")
    if (s%time_options%redo) call line("  redone             "//plural(int(s%redone_steps), "step", "steps")//" with " &
                                       //plural(int(s%halvings), "halving", "halvings"))
    call line("  speed              "//short_number(rate)//"particle-steps/s on " &
              //worker_words(costs%threads)//", " &
              //text_of(1.0e9_dp*ranks*costs%threads/max(rate, 1.0e-9_dp), 3)//" ns of a core each")
    call line("  seconds            "//text_of(costs%stepping, 3)//" stepping (particles "//text_of(nint(particles)) &
              //" %, grid "//text_of(nint(grid))//" %, sort "//text_of(nint(sorting))//" %), " &
              //text_of(costs%output, 3)//" output, "//text_of(costs%setup, 3)//" set-up")
    if (ranks > 1) call line(together_words(together, costs%stepping + costs%output + costs%setup, s%step - costs%steps_before))
    call line("  energy_residual    "//text_of(energy_residual(s%books), 3)//"   (books; round-off is right)")
    call line("  energy_drift       "//text_of(energy_drift(s%books), 3) &
              //"   (kinetic + stored + dissipated - work, of the largest energy exchanged)")
    if (energy_drift(s%books) > burst) call line("  warning            most of this energy came out of nothing: the method is not stable here;" &
                                                 //" shorter steps, musl or a transfer that damps may be")
    call line("  momentum_residual  "//text_of(momentum_residual(s%books, recorder%totals%momentum), 3))
    if (s%books%cut_momentum > adrift*s%books%momentum_scale) &
      call line("  warning            nodes with no mass to speak of took "//text_of(s%books%cut_momentum/s%books%momentum_scale, 2) &
                //" times the largest momentum: the motion is not to be trusted")
    if (recorder%has_solution) then
      call line("  error_rms          "//text_of(recorder%errors%rms/error_scale(recorder%solution), 4) &
                //"   error_max "//text_of(recorder%errors%max/error_scale(recorder%solution), 4)//"   against " &
                //solution_name(recorder%solution)//", "//error_scale_text(recorder%solution))
      call line("                     velocity "//text_of(recorder%errors%rms_velocity, 3)//" m/s, stress " &
                //text_of(recorder%errors%rms_stress, 3)//" Pa (rms)")
    end if
    call print_counts(s)
    call line("  state_hash         "//whole%hash)
    call line("  output             "//recorder%path//", "//plural(recorder%frame, "frame", "frames"))
  end subroutine print_closing

  !> How a run goes on that was stopped early
  subroutine print_going_on(name, why)
    character(len=*), intent(in) :: name !! of the output
    character(len=*), intent(in) :: why !! it was stopped
    if (this_rank > 0) return
    call line("  stopped by "//why//"; go on with --restart "//newest_path(name)//" and the same scene")
  end subroutine print_going_on

  !> What was clamped, cut or removed: silence means none
  subroutine print_counts(s)
    type(stepper_t), intent(in) :: s
    call say(s%books%clamped, "particle domains shortened to the longest allowed (particle-steps)")
    call say(s%books%detached, "domains with collapsed or far corners, which follow F from then on")
    call say(s%books%wide_chunks, "chunks through the list kernel (wide supports or drift)")
    call say(s%books%spilled, "node values beyond a pad")
    call say(s%books%cut_nodes, "nodes below the mass cut-off (node-steps); momentum lost "//text_of(s%books%cut_momentum, 3)//" kg m/s")
    call say(s%books%handed, "particles whose light nodes handed on force (particle-steps); impulse handed on "// &
             text_of(s%books%handed_impulse, 3)//" kg m/s")
    call say(particles_put_back(s%books), "particles put back onto a side that they had passed (particle-steps)")
    call say(points_beyond(s%books), "points of domains beyond the mesh, weighted with the element before them (particle-steps)")
    call say(s%books%removed_particles, "particles removed at free sides")
    call say(s%books%lost_loads, "load points on inactive nodes: force was lost")
    call line("  sorts              "//with_thousands(s%books%sorts))
    if (s%engine%grid%is_mesh) call line("  search             "//search_words(s%books, s%particle_steps))
    if (s%method%filter_every > 0) call line("  null-space filter  took "//text_of(s%books%filtered, 3)//" J of kinetic energy")

  contains

    subroutine say(n, what)
      integer(i8), intent(in) :: n
      character(len=*), intent(in) :: what
      if (n > 0) call line("  counted            "//with_thousands(n)//" "//what)
    end subroutine say

  end subroutine print_counts

  !> "2 threads", "4 ranks of 1 thread"
  function worker_words(threads) result(words)
    integer, intent(in) :: threads !! of each rank
    character(len=:), allocatable :: words
    words = plural(threads, "thread", "threads")
    if (ranks > 1) words = text_of(ranks)//" ranks of "//words
  end function worker_words

  !> The closing table as attributes of /summary
  subroutine write_closing(build, s, whole, together, recorder, costs, status, error)
    type(build_t), intent(in) :: build
    type(together_t), intent(in) :: together
    type(stepper_t), intent(in) :: s
    type(whole_t), intent(in) :: whole
    type(recorder_t), intent(inout) :: recorder
    type(costs_t), intent(in) :: costs
    character(len=*), intent(in) :: status
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: rate
    rate = s%particle_steps/max(costs%stepping, 1.0e-9_dp)
    call word("status", status)
    call count("steps", s%step)
    call number("time", s%time)
    call count("particles", whole%particles)
    call count("threads", int(costs%threads, i8))
    call count("ranks", int(ranks, i8))
    call number("wall_seconds", costs%stepping)
    call number("seconds_setup", costs%setup)
    call number("seconds_output", costs%output)
    call number("seconds_grid", s%seconds(phase_grid))
    call number("seconds_particles", s%seconds(phase_particles))
    call number("seconds_sort", s%seconds(phase_sort))
    call number("seconds_checks", s%seconds(phase_checks))
    call number("particle_steps_per_second", rate)
    call number("particle_steps_per_core_second", rate/(ranks*costs%threads))
    call number("bytes_per_particle", real(whole%bytes, dp)/max(1_i8, whole%particles))
    call number("state_bytes_per_particle", real(live_bytes(s%engine%particles), dp))
    call write_together(recorder%output, together, error)
    call number("dt_min", min(costs%dt_min, costs%dt_max))
    call number("dt_max", costs%dt_max)
    if (s%time_options%check /= check_none) then
      call number("critical_step_min", s%least_critical)
      call number("critical_share_max", s%critical_share)
    end if
    call count("redone_steps", s%redone_steps)
    call count("halvings", s%halvings)
    call number("energy_residual", energy_residual(s%books))
    call number("energy_drift", energy_drift(s%books))
    call number("momentum_residual", momentum_residual(s%books, recorder%totals%momentum))
    call word("state_hash", whole%hash)
    call count("sorts", s%books%sorts)
    call count("clamped_domains", s%books%clamped)
    call count("detached_domains", s%books%detached)
    call count("wide_chunks", s%books%wide_chunks)
    call count("spilled_values", s%books%spilled)
    call count("cut_nodes", s%books%cut_nodes)
    call count("redistributed_forces", s%books%handed)
    call number("redistributed_impulse", s%books%handed_impulse)
    call count("removed_particles", s%books%removed_particles)
    call count("lost_loads", s%books%lost_loads)
    if (s%method%filter_every > 0) call number("filtered_energy", s%books%filtered)
    if (s%engine%grid%is_mesh) call write_mesh_summary(recorder%output, s%engine, s%books, s%particle_steps, error)
    if (recorder%has_solution) then
      call word("error_solution", solution_name(recorder%solution))
      call word("error_scale_by", error_scale_text(recorder%solution))
      call number("error_scale", error_scale(recorder%solution))
      call number("error_rms", recorder%errors%rms/error_scale(recorder%solution))
      call number("error_max", recorder%errors%max/error_scale(recorder%solution))
      call number("error_rms_velocity", recorder%errors%rms_velocity)
      call number("error_max_velocity", recorder%errors%max_velocity)
      call number("error_rms_stress", recorder%errors%rms_stress)
      call number("error_max_stress", recorder%errors%max_stress)
    end if
    call word("version", trim(build%version))
    call word("commit", trim(build%commit))
    call word("build", trim(build%kind))
    call word("compiler", compiler_version())
    call word("precision", precision_word)

  contains

    subroutine number(name, value)
      character(len=*), intent(in) :: name
      real(dp), intent(in) :: value
      if (.not. allocated(error)) call put_summary(recorder%output, name, value, error)
    end subroutine number

    subroutine count(name, value)
      character(len=*), intent(in) :: name
      integer(i8), intent(in) :: value
      if (.not. allocated(error)) call put_summary(recorder%output, name, value, error)
    end subroutine count

    subroutine word(name, value)
      character(len=*), intent(in) :: name, value
      if (.not. allocated(error)) call put_summary(recorder%output, name, value, error)
    end subroutine word

  end subroutine write_closing

  subroutine line(text)
    character(len=*), intent(in) :: text
    write (output_unit, "(a)") text
  end subroutine line

end module gimp_report
