!> Checkpoints of a run: when one is due, what is in it, and how a run goes on from it.
!>
!> A checkpoint holds everything that steers a later bit: particles with their spare lanes in stored order, the groups and blocks
!> they stand in, what they gave to the grid (see `gimp_engine_store`), the clocks, peaks and books of the stepper, and where the output stands. Giving to the
!> grid again would not do: a pass that takes and gives at once may round otherwise, and gives body forces of a time that was
!> summed, not multiplied (7e-12 of difference with equal steps). What follows from the scene is made from the scene. Nothing
!> depends on threads or ranks.
module gimp_restart
  use gimp_kinds, only: dp, i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_timer, only: seconds_now
  use gimp_parcel, only: parcel_t, carry, pack_parcel, is_used_up
  use gimp_scene, only: scene_t, echo_scene, scene_differences, real_of, integer_of, text_of_key, complain
  use gimp_verification, only: verification_t
  use gimp_ranks, only: this_rank
  use gimp_over_ranks, only: share_error
  use gimp_hdf5, only: hdf5_file_t, close_hdf5, write_attribute, read_attribute, has_attribute, write_text, read_text
  use gimp_shared_hdf5, only: shared_file_t, end_layout
  use gimp_checkpoint, only: newest_path, begin_checkpoint, end_checkpoint, drop_checkpoint, open_checkpoint, twin_of, &
    write_parcel, read_parcel, check_lineage
  use gimp_engine_store, only: describe_engine, announce_engine, write_engine, read_engine
  use gimp_mesh_content, only: mesh_hash
  use gimp_run_state, only: stepper_t, carry_stepper
  use gimp_stepper, only: resume_run
  use gimp_recorder, only: recorder_t, keep_record, unpack_record
  use gimp_report, only: costs_t
  implicit none(type, external)
  private
  public :: restart_t, set_up_restart, check_checkpoint, load_checkpoint, start_checkpoints, checkpoint_due, write_checkpoint
  public :: continued_words

  !> When checkpoints are written, and what the run goes on from
  type :: restart_t
    logical :: asked = .false. !! checkpoints are to be written
    real(dp) :: every = 0.0_dp !! [s], of simulated time
    integer :: every_steps = 0
    real(dp) :: every_seconds = 0.0_dp !! wall clock
    real(dp) :: max_seconds = 0.0_dp !! wall clock by which the run must be over; 0: no limit
    character(len=:), allocatable :: name !! of the output
    character(len=:), allocatable :: complete !! the scene with all defaults
    character(len=:), allocatable :: from !! checkpoint that this run goes on from; empty: it starts anew
    integer(i8) :: from_step = 0
    character(len=:), allocatable :: mesh !! hash of its content; empty: there is a grid
    character(len=:), allocatable :: lineage !! of the output file, as `from` has it
    integer(i8) :: last_step = -1 !! of the last checkpoint
    integer(i8) :: multiple = 0 !! of `every` that was last passed
    real(dp) :: last_seconds = 0.0_dp
    logical :: keep_present = .false. !! NAME.checkpoint.h5 is of this run: keep it as the older one
    type(hdf5_file_t), private :: file !! `from`, while it is being read
  end type restart_t

contains

  !> What the scene says about checkpoints
  subroutine set_up_restart(scene, s, restart)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in) :: s
    type(restart_t), intent(out) :: restart
    restart%every = real_of(scene, "restart", 1, "every")
    restart%every_steps = integer_of(scene, "restart", 1, "every_steps")
    restart%every_seconds = 60.0_dp*real_of(scene, "restart", 1, "every_minutes")
    restart%max_seconds = 60.0_dp*real_of(scene, "restart", 1, "max_walltime")
    restart%asked = restart%every > 0.0_dp .or. restart%every_steps > 0 .or. restart%every_seconds > 0.0_dp
    restart%from = text_of_key(scene, "restart", 1, "from")
    restart%name = text_of_key(scene, "output", 1, "name")
    restart%keep_present = restart%from == newest_path(restart%name)
    restart%lineage = ""
    restart%mesh = ""
    if (s%engine%grid%is_mesh) restart%mesh = mesh_hash(s%engine%mesh, s%engine%grid)
    call echo_scene(scene, restart%complete)
  end subroutine set_up_restart

  !> "from step 120 of PATH, t = 0.5 s"; empty for a run that starts anew
  function continued_words(restart, s) result(words)
    type(restart_t), intent(in) :: restart
    type(stepper_t), intent(in) :: s
    character(len=:), allocatable :: words
    words = ""
    if (restart%from /= "") words = "from step "//text_of(restart%from_step)//" of "//restart%from//", t = "//text_of(s%time)//" s"
  end function continued_words

  ! ------------------------------------------------------------------------------------------------ reading

  !> Whether the run can go on from the checkpoint that the scene names: it is whole, of this scene and of the output file that is
  !> there. Without one nothing happens. Collective
  subroutine check_checkpoint(restart, scene, error)
    type(restart_t), intent(inout) :: restart
    type(scene_t), intent(in) :: scene
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: problem
    character(len=:), allocatable :: kept, differences, mesh
    if (restart%from == "") return
    call open_checkpoint(restart%from, restart%file, problem)
    if (.not. allocated(problem)) call read_attribute(restart%file, "", "step", restart%from_step, problem)
    if (.not. allocated(problem)) call read_attribute(restart%file, "", "lineage", restart%lineage, problem)
    if (.not. allocated(problem)) call read_text(restart%file, "scene", kept, problem)
    mesh = ""
    if (.not. allocated(problem)) then
      if (has_attribute(restart%file, "", "mesh_hash")) call read_attribute(restart%file, "", "mesh_hash", mesh, problem)
    end if
    call share_error(problem)
    if (allocated(problem)) then
      call complain(error, scene, "restart", 1, "from", problem%message//twin_of(restart%from))
      return
    end if
    differences = scene_differences(kept, restart%complete)
    if (differences /= "") then
      call complain(error, scene, "restart", 1, "from", "is a checkpoint of another scene: "//differences)
    else if (mesh /= restart%mesh) then
      call complain(error, scene, "restart", 1, "from", "is a checkpoint on another mesh: "//text_of_key(scene, "mesh", 1, "file") &
                    //" holds other nodes, elements or names than when it was written")
    end if
    call check_lineage(restart%name//".vtkhdf", restart%lineage, restart%from_step, problem)
    if (allocated(problem)) call complain(error, scene, "restart", 1, "from", problem%message)
  end subroutine check_checkpoint

  !> Put the state of the checkpoint in place of the initial one. The particles were made from the scene: the fields are announced.
  !> Collective
  subroutine load_checkpoint(restart, scene, s, solution, body_first, recorder, costs, error)
    type(restart_t), intent(inout) :: restart
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(verification_t), intent(in) :: solution
    integer(i8), intent(in) :: body_first(:)
    type(recorder_t), intent(inout) :: recorder
    type(costs_t), intent(inout) :: costs
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: problem, ignored
    type(parcel_t) :: parcel
    call read_engine(restart%file, s%engine, problem)
    if (.not. allocated(problem)) call read_parcel(restart%file, "run", parcel, problem)
    if (.not. allocated(problem)) then
      call carry_stepper(s, parcel)
      call carry_costs(costs, parcel)
      if (.not. is_used_up(parcel)) call raise(problem, other_program(restart%from))
    end if
    if (.not. allocated(problem)) call read_parcel(restart%file, "output", parcel, problem)
    call share_error(problem)
    if (.not. allocated(problem)) then
      call unpack_record(scene, s, solution, body_first, parcel, recorder, problem)
      if (.not. allocated(problem) .and. .not. is_used_up(parcel)) call raise(problem, other_program(restart%from))
    end if
    call share_error(problem)
    call close_hdf5(restart%file, ignored)
    if (allocated(problem)) then
      call complain(error, scene, "restart", 1, "from", problem%message)
      return
    end if
    call resume_run(s)
    restart%last_step = s%step
  end subroutine load_checkpoint

  pure function other_program(path) result(words)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: words
    words = path//": holds other things than this program looks for; it was written by another version of gimp.x"
  end function other_program

  ! ------------------------------------------------------------------------------------------------ writing

  !> The clocks of checkpoints start
  subroutine start_checkpoints(restart, s)
    type(restart_t), intent(inout) :: restart
    type(stepper_t), intent(in) :: s
    restart%last_seconds = seconds_now()
    restart%multiple = multiple_of(restart, s)
  end subroutine start_checkpoints

  !> Whether a checkpoint is due after this step
  logical function checkpoint_due(restart, s) result(due)
    type(restart_t), intent(in) :: restart
    type(stepper_t), intent(in) :: s
    due = .false.
    if (.not. restart%asked) return
    if (restart%every_steps > 0) due = modulo(s%step, int(restart%every_steps, i8)) == 0
    if (restart%every > 0.0_dp) due = due .or. multiple_of(restart, s) > restart%multiple
    if (restart%every_seconds > 0.0_dp .and. .not. due) due = seconds_now() - restart%last_seconds >= restart%every_seconds
  end function checkpoint_due

  !> How often `every` fits into the time so far
  pure integer(i8) function multiple_of(restart, s) result(multiple)
    type(restart_t), intent(in) :: restart
    type(stepper_t), intent(in) :: s
    multiple = 0
    if (restart%every > 0.0_dp) multiple = floor(s%time/restart%every + 1.0e-9_dp, i8)
  end function multiple_of

  !> Write one. The run fails if that is impossible: a run that believes in checkpoints must not go on without. Collective
  subroutine write_checkpoint(restart, s, recorder, costs, error)
    type(restart_t), intent(inout) :: restart
    type(stepper_t), intent(inout) :: s
    type(recorder_t), intent(inout) :: recorder
    type(costs_t), intent(inout) :: costs
    type(error_t), allocatable, intent(out) :: error
    type(shared_file_t) :: shared
    type(parcel_t) :: output
    call pack_parcel(output)
    call keep_record(recorder, s%time_options%end, output, error)
    call share_error(error)
    if (.not. allocated(error)) call begin_checkpoint(restart%name, shared, error)
    if (.not. allocated(error)) call lay_out_state(restart, s, recorder, costs, output, shared, error)
    if (.not. allocated(error)) then
      call write_engine(shared, s%engine, error)
      call end_checkpoint(restart%name, restart%keep_present, shared, error)
    end if
    if (allocated(error)) then
      error%message = "the checkpoint at step "//text_of(s%step)//" could not be written: "//error%message
      call drop_checkpoint(restart%name, shared)
      return
    end if
    restart%keep_present = .true.
    restart%last_step = s%step
    restart%last_seconds = seconds_now()
    restart%multiple = multiple_of(restart, s)
  end subroutine write_checkpoint

  !> What is told once, and room for what each rank writes. Collective
  subroutine lay_out_state(restart, s, recorder, costs, output, shared, error)
    type(restart_t), intent(in) :: restart
    type(stepper_t), intent(inout) :: s
    type(recorder_t), intent(in) :: recorder
    type(costs_t), intent(inout) :: costs
    type(parcel_t), intent(in) :: output
    type(shared_file_t), intent(inout) :: shared
    type(error_t), allocatable, intent(out) :: error
    type(parcel_t) :: run
    if (this_rank == 0) then
      call pack_parcel(run)
      call carry_stepper(s, run)
      call carry_costs(costs, run)
      call write_attribute(shared%file, "", "step", s%step, error)
      if (.not. allocated(error)) call write_attribute(shared%file, "", "time", real(s%time, dp), error)
      if (.not. allocated(error)) call write_attribute(shared%file, "", "lineage", recorder%lineage, error)
      if (.not. allocated(error) .and. restart%mesh /= "") call write_attribute(shared%file, "", "mesh_hash", restart%mesh, error)
      if (.not. allocated(error)) call write_text(shared%file, "scene", restart%complete, error)
      if (.not. allocated(error)) call write_parcel(shared%file, "run", run, error)
      if (.not. allocated(error)) call write_parcel(shared%file, "output", output, error)
      if (.not. allocated(error)) call describe_engine(shared%file, s%engine, error)
    end if
    call share_error(error)
    if (allocated(error)) return
    call announce_engine(shared, s%engine)
    call end_layout(shared, error)
  end subroutine lay_out_state

  !> What the closing table adds up over all runs that a checkpoint joins
  pure subroutine carry_costs(costs, parcel)
    type(costs_t), intent(inout) :: costs
    type(parcel_t), intent(inout) :: parcel
    integer :: k
    call carry(parcel, costs%stepping)
    call carry(parcel, costs%output)
    call carry(parcel, costs%dt_min)
    call carry(parcel, costs%dt_max)
    do k = 1, size(costs%limited)
      call carry(parcel, costs%limited(k))
    end do
  end subroutine carry_costs

end module gimp_restart
