!> What a run will cost, told by `--check`: memory on other numbers of ranks, room on the disk, and hours, from a few steps that are
!> tried and thrown away. All ranks work, the first one speaks.
module gimp_forecast
  use gimp_kinds, only: dp, i8, lanes
  use gimp_error, only: error_t
  use gimp_text, only: text_of, with_thousands, short_number
  use gimp_timer, only: seconds_now
  use gimp_ranks, only: this_rank, ranks
  use gimp_over_ranks, only: share_error, sum_counts
  use gimp_grid, only: nf => fields_per_node
  use gimp_engine, only: engine_t, pad_bytes
  use gimp_scene, only: scene_t, count_groups, real_of, integer_of, word_of, texts_of, reals_of, is_given
  use gimp_snapshot, only: field_components
  use gimp_mesh_report, only: mesh_bytes, pad_bytes_of_patch
  use gimp_run_state, only: stepper_t, stepper_bytes
  use gimp_stepper, only: plan_step, take_step
  use gimp_report, only: estimated_steps, usual_step, share_done
  use, intrinsic :: iso_fortran_env, only: output_unit
  implicit none(type, external)
  private
  public :: tell_forecast

  real(dp), parameter :: trial_seconds = 3.0_dp !! after which no further step is tried
  integer, parameter :: trial_steps = 50
  integer, parameter :: double = 8, single = 4 !! bytes
  integer, parameter :: columns = 31 !! of the history of every run
  integer, parameter :: rows_together = 512 !! of the history, in the file
  integer, parameter :: bytes_of_vertex = 24 !! of a particle, once for all frames that have as many

contains

  !> Tell it. Collective; the state is not that of the start any more. An error is that of a step that was tried
  subroutine tell_forecast(scene, s, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: left, until, seconds
    integer(i8) :: particles, checkpoint
    integer :: tried
    left = estimated_steps(s)*(1.0_dp - share_done(s))
    until = min(s%time_options%end, s%time + left*usual_step(s))
    particles = sum_counts(s%engine%particles%n)
    checkpoint = sum_counts(checkpoint_bytes(s%engine))
    if (ranks == 1) call tell_ranks(s)
    if (this_rank == 0) call tell_disk(scene, particles, checkpoint, until, estimated_steps(s))
    call try_steps(s, tried, seconds, error)
    if (allocated(error) .or. this_rank > 0 .or. tried == 0) return
    write (output_unit, "(a)") "  duration   about "//duration(left*seconds)//": "//with_thousands(ceiling(left, i8))//" steps of " &
      //duration(seconds)//" (of "//text_of(tried)//" that were tried)"
  end subroutine tell_forecast

  !> Take some steps. The first is not counted: memory is touched for the first time
  subroutine try_steps(s, tried, seconds, error)
    type(stepper_t), intent(inout) :: s
    integer, intent(out) :: tried !! steps
    real(dp), intent(out) :: seconds !! that one takes
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: start
    integer :: enough
    tried = 0
    seconds = 0.0_dp
    start = seconds_now()
    do while (tried < trial_steps .and. s%time_options%end - s%time > 1.0e-9_dp*s%dt)
      call plan_step(s, s%time_options%end - s%time, error)
      call share_error(error)
      if (.not. allocated(error)) call take_step(s, error)
      enough = merge(1, 0, seconds_now() - start > trial_seconds)
      call share_error(error, enough)
      if (allocated(error)) then
        error%message = "step "//text_of(tried + 1)//" of those that were tried went wrong: "//error%message
        return
      end if
      tried = tried + 1
      if (tried > 1) seconds = (seconds_now() - start)/(tried - 1)
      if (enough > 0) exit
      if (tried == 1) start = seconds_now()
    end do
    if (tried == 1) seconds = seconds_now() - start
  end subroutine try_steps

  !> Memory on other numbers of ranks: the share of each, and the pads of the blocks around it
  subroutine tell_ranks(s)
    type(stepper_t), intent(in) :: s
    integer, parameter :: numbers(4) = [4, 16, 64, 256]
    character(len=:), allocatable :: words
    real(dp) :: own, around
    integer(i8) :: pad
    integer :: k, d
    d = s%engine%grid%dim
    words = ""
    pad = pad_bytes(d, s%engine%basis, 1)
    if (s%engine%grid%is_mesh) pad = pad_bytes_of_patch(s%engine)
    do k = 1, size(numbers)
      own = real(s%engine%table%blocks, dp)/numbers(k)
      if (own < 2.0_dp) exit ! a rank needs some blocks to be worth it
      around = (own**(1.0_dp/d) + 2.0_dp)**d - own
      words = words//", "//short_number(real(stepper_bytes(s), dp)/numbers(k) + around*pad + mesh_bytes(s%engine))//"B each on " &
              //text_of(numbers(k))
    end do
    if (words /= "") write (output_unit, "(a)") "  on ranks   about "//words(3:)
  end subroutine tell_ranks

  !> Room on the disk
  subroutine tell_disk(scene, particles, checkpoint, until, steps)
    type(scene_t), intent(in) :: scene
    integer(i8), intent(in) :: particles, checkpoint !! of all ranks; bytes of a checkpoint
    real(dp), intent(in) :: until !! [s]
    real(dp), intent(in) :: steps
    real(dp) :: every, frame, history
    integer(i8) :: frames
    every = real_of(scene, "output", 1, "every")
    frames = 2
    if (every > 0.0_dp) frames = 1 + ceiling(until/every - 1.0e-9_dp, i8)
    frame = frame_bytes(scene, particles)
    history = double*history_columns(scene)*rows_together*ceiling(steps/(rows_together*integer_of(scene, "output", 1, "history_every")))
    write (output_unit, "(a)") "  disk       "//with_thousands(frames)//" frames of "//short_number(frame)//"B, history " &
      //short_number(history)//"B, two checkpoints of "//short_number(real(checkpoint, dp))//"B where any are written: " &
      //short_number(frames*frame + particles*bytes_of_vertex + history + 2.0_dp*checkpoint)//"B"
  end subroutine tell_disk

  !> Bytes of a frame: positions and fields
  real(dp) function frame_bytes(scene, particles) result(bytes)
    type(scene_t), intent(in) :: scene
    integer(i8), intent(in) :: particles
    character(len=64), allocatable :: fields(:)
    integer :: k, numbers
    fields = texts_of(scene, "output", 1, "fields")
    numbers = 3
    do k = 1, size(fields)
      numbers = numbers + field_components(trim(fields(k)))
    end do
    bytes = real(particles, dp)*numbers*merge(double, single, word_of(scene, "output", 1, "precision") == "double")
  end function frame_bytes

  !> Columns of the history
  integer function history_columns(scene) result(n)
    type(scene_t), intent(in) :: scene
    n = columns
    if (count_groups(scene, "verification") > 0) n = n + 4
    if (is_given(scene, "output", 1, "probes")) &
      n = n + size(reals_of(scene, "output", 1, "probes"))/scene%dimension*(2*scene%dimension + 4)
  end function history_columns

  !> Bytes that the blocks of this rank take in a checkpoint, which is in double precision
  pure integer(i8) function checkpoint_bytes(engine) result(bytes)
    type(engine_t), intent(in) :: engine
    bytes = int(double*lanes*(engine%particles%components + 1), i8)*engine%particles%chunks
    if (associated(engine%pad)) bytes = bytes + int(double*(nf*size(engine%pad, 2) + size(engine%sums, 1) + 2), i8)*engine%table%blocks
  end function checkpoint_bytes

  !> "0.25 ms", "40 s", "12 min", "3.5 hours", with two digits
  function duration(seconds) result(words)
    real(dp), intent(in) :: seconds
    character(len=:), allocatable :: words
    if (seconds < 1.0_dp) then
      words = text_of(1.0e3_dp*seconds, 2)//" ms"
    else if (seconds < 120.0_dp) then
      words = text_of(seconds, 2)//" s"
    else if (seconds < 7200.0_dp) then
      words = text_of(seconds/60.0_dp, 2)//" min"
    else
      words = text_of(seconds/3600.0_dp, 2)//" hours"
    end if
  end function duration

end module gimp_forecast
