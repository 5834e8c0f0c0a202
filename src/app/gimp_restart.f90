!> Checkpoints of a run: when one is due, what is in it, and how a run goes on from it.
!>
!> A checkpoint holds everything that steers a later bit: particles with their spare lanes in stored order, the groups and blocks
!> they stand in, what they gave to the grid, the clocks, peaks and books of the stepper, and where the output stands. Giving to the
!> grid again would not do: a pass that takes and gives at once may round otherwise, and gives body forces of a time that was
!> summed, not multiplied (7e-12 of difference with equal steps). What follows from the scene is made from the scene. Nothing
!> depends on threads.
module gimp_restart
  use gimp_kinds, only: wp, dp, i8, lanes, precision_word
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_timer, only: seconds_now
  use gimp_parcel, only: parcel_t, carry, pack_parcel, is_used_up
  use gimp_grid, only: nf => fields_per_node
  use gimp_particles, only: group_t
  use gimp_engine, only: engine_t
  use gimp_scene, only: scene_t, echo_scene, scene_differences, real_of, integer_of, text_of_key, complain
  use gimp_verification, only: verification_t
  use gimp_hdf5, only: hdf5_file_t, close_hdf5, create_group, write_dataset, read_dataset, write_attribute, read_attribute, &
    write_text, read_text
  use gimp_checkpoint, only: newest_path, begin_checkpoint, end_checkpoint, drop_checkpoint, open_checkpoint, twin_of, &
    write_parcel, read_parcel, check_lineage
  use gimp_saved_state, only: recall_groups
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
    character(len=:), allocatable :: name !! of the output
    character(len=:), allocatable :: complete !! the scene with all defaults
    character(len=:), allocatable :: from !! checkpoint that this run goes on from; empty: it starts anew
    integer(i8) :: from_step = 0
    character(len=:), allocatable :: lineage !! of the output file, as `from` has it
    integer(i8) :: last_step = -1 !! of the last checkpoint
    integer(i8) :: multiple = 0 !! of `every` that was last passed
    real(dp) :: last_seconds = 0.0_dp
    logical :: keep_present = .false. !! NAME.checkpoint.h5 is of this run: keep it as the older one
    type(hdf5_file_t), private :: file !! `from`, while it is being read
  end type restart_t

contains

  !> What the scene says about checkpoints
  subroutine set_up_restart(scene, restart)
    type(scene_t), intent(in) :: scene
    type(restart_t), intent(out) :: restart
    restart%every = real_of(scene, "restart", 1, "every")
    restart%every_steps = integer_of(scene, "restart", 1, "every_steps")
    restart%every_seconds = 60.0_dp*real_of(scene, "restart", 1, "every_minutes")
    restart%asked = restart%every > 0.0_dp .or. restart%every_steps > 0 .or. restart%every_seconds > 0.0_dp
    restart%from = text_of_key(scene, "restart", 1, "from")
    restart%name = text_of_key(scene, "output", 1, "name")
    restart%keep_present = restart%from == newest_path(restart%name)
    restart%lineage = ""
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
  !> there. Without one nothing happens.
  subroutine check_checkpoint(restart, scene, error)
    type(restart_t), intent(inout) :: restart
    type(scene_t), intent(in) :: scene
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: problem
    character(len=:), allocatable :: kept, differences
    if (restart%from == "") return
    call open_checkpoint(restart%from, restart%file, problem)
    if (.not. allocated(problem)) call read_attribute(restart%file, "", "step", restart%from_step, problem)
    if (.not. allocated(problem)) call read_attribute(restart%file, "", "lineage", restart%lineage, problem)
    if (.not. allocated(problem)) call read_text(restart%file, "scene", kept, problem)
    if (allocated(problem)) then
      call complain(error, scene, "restart", 1, "from", problem%message//twin_of(restart%from))
      return
    end if
    differences = scene_differences(kept, restart%complete)
    if (differences /= "") call complain(error, scene, "restart", 1, "from", "is a checkpoint of another scene: "//differences)
    call check_lineage(restart%name//".vtkhdf", restart%lineage, restart%from_step, problem)
    if (allocated(problem)) call complain(error, scene, "restart", 1, "from", problem%message)
  end subroutine check_checkpoint

  !> Put the state of the checkpoint in place of the initial one. The particles were made from the scene: the fields are announced.
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
    if (.not. allocated(problem)) then
      call unpack_record(scene, s, solution, body_first, parcel, recorder, problem)
      if (.not. allocated(problem) .and. .not. is_used_up(parcel)) call raise(problem, other_program(restart%from))
    end if
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

  !> Particles, blocks and pads
  subroutine read_engine(file, engine, error)
    type(hdf5_file_t), intent(in) :: file
    type(engine_t), intent(inout) :: engine
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: groups(:, :)
    character(len=:), allocatable :: fields
    type(group_t), allocatable :: list(:)
    integer :: g
    call read_text(file, "particles/fields", fields, error)
    if (allocated(error)) return
    if (fields /= list_fields(engine)) then
      call raise(error, file%path//": its particles have the fields "//fields//"; this scene wants "//list_fields(engine))
      return
    end if
    call read_dataset(file, "particles/groups", groups, error)
    if (allocated(error)) return
    allocate (list(size(groups, 2)))
    do g = 1, size(list)
      list(g) = group_t(int(groups(1, g)), int(groups(2, g)), int(groups(3, g)), int(groups(4, g)), int(groups(5:7, g)))
    end do
    call recall_groups(engine, list)
    call read_values(file, engine, error)
  end subroutine read_engine

  !> Fill what was rebuilt
  subroutine read_values(file, engine, error)
    type(hdf5_file_t), intent(in) :: file
    type(engine_t), intent(inout) :: engine
    type(error_t), allocatable, intent(out) :: error
    real(dp), allocatable :: values(:, :)
    integer(i8), allocatable :: numbers(:, :)
    integer :: k
    call take_reals("particles/values", lanes*engine%particles%components, engine%particles%chunks)
    if (allocated(error)) return
    do k = 1, engine%particles%chunks
      engine%particles%p(:, :, k) = real(reshape(values(:, k), [lanes, engine%particles%components]), wp) ! exact
    end do
    call take_numbers("particles/id", lanes, engine%particles%chunks)
    if (allocated(error)) return
    engine%particles%id = numbers
    engine%particles%n = count(engine%particles%id > 0, kind=i8)
    call take_reals("blocks/pads", nf*size(engine%pad, 2), engine%table%blocks)
    if (allocated(error)) return
    do k = 1, engine%table%blocks
      engine%pad(:, :, k) = real(reshape(values(:, k), [nf, size(engine%pad, 2)]), wp)
    end do
    call take_reals("blocks/sums", size(engine%sums, 1), engine%table%blocks)
    if (allocated(error)) return
    engine%sums = values
    call take_numbers("blocks/marks", 2, engine%table%blocks)
    if (allocated(error)) return
    engine%drifted = numbers(1, :) /= 0
    engine%restless = numbers(2, :) /= 0
    call read_dataset(file, "spill/values", values, error)
    if (.not. allocated(error)) call read_dataset(file, "spill/places", numbers, error)
    if (allocated(error)) return
    associate (spill => engine%spill)
      spill%n = size(numbers, 2)
      spill%block = [int(numbers(1, :)), (0, k=1, 64)] ! room for more, as the passes expect it
      spill%slot = [int(numbers(2, :)), (0, k=1, 64)]
      spill%place = [int(numbers(3, :)), (0, k=1, 64)]
      deallocate (spill%value)
      allocate (spill%value(nf, spill%n + 64), source=0.0_wp)
      spill%value(:, :spill%n) = real(values, wp)
    end associate

  contains

    subroutine take_reals(path, rows, columns)
      character(len=*), intent(in) :: path
      integer, intent(in) :: rows, columns
      call read_dataset(file, path, values, error)
      if (.not. allocated(error)) call check_shape(path, shape(values), [rows, columns])
    end subroutine take_reals

    subroutine take_numbers(path, rows, columns)
      character(len=*), intent(in) :: path
      integer, intent(in) :: rows, columns
      call read_dataset(file, path, numbers, error)
      if (.not. allocated(error)) call check_shape(path, shape(numbers), [rows, columns])
    end subroutine take_numbers

    subroutine check_shape(path, found, wanted)
      character(len=*), intent(in) :: path
      integer, intent(in) :: found(2), wanted(2)
      if (any(found /= wanted)) call raise(error, file%path//": dataset "//path//" has another shape than this program stores; " &
                                           //"it was written by another version of gimp.x")
    end subroutine check_shape

  end subroutine read_values

  !> "double precision, position 2, velocity 2, ...": what a particle stores, in order
  function list_fields(engine) result(list)
    type(engine_t), intent(in) :: engine
    character(len=:), allocatable :: list
    integer :: k
    list = precision_word//" precision"
    do k = 1, size(engine%particles%fields)
      list = list//", "//trim(engine%particles%fields(k)%name)//" "//text_of(engine%particles%fields(k)%components)
    end do
  end function list_fields

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

  !> Write one. The run fails if that is impossible: a run that believes in checkpoints must not go on without.
  subroutine write_checkpoint(restart, s, recorder, costs, error)
    type(restart_t), intent(inout) :: restart
    type(stepper_t), intent(inout) :: s
    type(recorder_t), intent(inout) :: recorder
    type(costs_t), intent(inout) :: costs
    type(error_t), allocatable, intent(out) :: error
    type(hdf5_file_t) :: file
    type(parcel_t) :: run, output
    call pack_parcel(run)
    call carry_stepper(s, run)
    call carry_costs(costs, run)
    call pack_parcel(output)
    call keep_record(recorder, s%time_options%end, output, error)
    if (.not. allocated(error)) call begin_checkpoint(restart%name, file, error)
    if (.not. allocated(error)) call write_attribute(file, "", "step", s%step, error)
    if (.not. allocated(error)) call write_attribute(file, "", "time", real(s%time, dp), error)
    if (.not. allocated(error)) call write_attribute(file, "", "lineage", recorder%lineage, error)
    if (.not. allocated(error)) call write_text(file, "scene", restart%complete, error)
    if (.not. allocated(error)) call write_parcel(file, "run", run, error)
    if (.not. allocated(error)) call write_parcel(file, "output", output, error)
    if (.not. allocated(error)) call write_engine(file, s%engine, error)
    if (.not. allocated(error)) call end_checkpoint(restart%name, restart%keep_present, file, error)
    if (allocated(error)) then
      error%message = "the checkpoint at step "//text_of(s%step)//" could not be written: "//error%message
      call drop_checkpoint(restart%name, file)
      return
    end if
    restart%keep_present = .true.
    restart%last_step = s%step
    restart%last_seconds = seconds_now()
    restart%multiple = multiple_of(restart, s)
  end subroutine write_checkpoint

  subroutine write_engine(file, engine, error)
    type(hdf5_file_t), intent(in) :: file
    type(engine_t), intent(in) :: engine
    type(error_t), allocatable, intent(out) :: error
    real(wp), pointer, contiguous :: flat(:, :)
    integer, allocatable :: groups(:, :), marks(:, :), places(:, :)
    integer :: g, n
    n = engine%spill%n
    allocate (groups(7, size(engine%particles%groups)), marks(2, engine%table%blocks), places(3, n))
    marks(1, :) = merge(1, 0, engine%drifted)
    marks(2, :) = merge(1, 0, engine%restless)
    places(1, :) = engine%spill%block(:n)
    places(2, :) = engine%spill%slot(:n)
    places(3, :) = engine%spill%place(:n)
    do g = 1, size(engine%particles%groups)
      associate (group => engine%particles%groups(g))
        groups(:, g) = [group%block, group%material, group%first, group%last, group%at]
      end associate
    end do
    call create_group(file, "particles", error)
    if (.not. allocated(error)) call write_text(file, "particles/fields", list_fields(engine), error)
    if (.not. allocated(error)) call write_dataset(file, "particles/groups", groups, error)
    flat(1:lanes*engine%particles%components, 1:engine%particles%chunks) => engine%particles%p
    if (.not. allocated(error)) call write_dataset(file, "particles/values", flat, error)
    if (.not. allocated(error)) call write_dataset(file, "particles/id", engine%particles%id, error)
    if (.not. allocated(error)) call create_group(file, "blocks", error)
    flat(1:nf*size(engine%pad, 2), 1:engine%table%blocks) => engine%pad
    if (.not. allocated(error)) call write_dataset(file, "blocks/pads", flat, error)
    if (.not. allocated(error)) call write_dataset(file, "blocks/sums", engine%sums, error)
    if (.not. allocated(error)) call write_dataset(file, "blocks/marks", marks, error)
    if (.not. allocated(error)) call create_group(file, "spill", error)
    if (.not. allocated(error)) call write_dataset(file, "spill/places", places, error)
    if (.not. allocated(error)) call write_dataset(file, "spill/values", engine%spill%value(:, :n), error)
  end subroutine write_engine

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
