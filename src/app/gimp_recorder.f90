!> What a run leaves behind: frames, history, summary, and the state of a run that failed. All ranks call it together
module gimp_recorder
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_parcel, only: parcel_t, carry, carry_bits
  use gimp_ranks, only: this_rank
  use gimp_over_ranks, only: sum_counts, share_text, share_error
  use gimp_file_system, only: delete_file, file_bytes
  use gimp_engine, only: engine_t
  use gimp_scene, only: scene_t, echo_scene, real_of, reals_of, integer_of, logical_of, word_of, text_of_key, texts_of, is_given
  use gimp_output_file, only: output_file_t, open_output, close_output, carry_output, sync_output, reopen_output, sign_output
  use gimp_vtkhdf, only: frames_t, open_frames, begin_frame, add_field, end_frame, carry_frames
  use gimp_history, only: history_t, open_history, append_row, commit_history, close_history, carry_history, &
    reopen_csv
  use gimp_checkpoint, only: newest_path, older_path, longer_lineage
  use gimp_summary, only: write_scene, put_summary
  use gimp_particle_file, only: particle_table_t, write_particle_file
  use gimp_verification, only: verification_t, error_scale
  use gimp_measures, only: totals_t, errors_t, measure_totals, measure_errors, measure_probes, probe_values, nearest_particle, &
    chunk_position, chunk_stress, chunk_deformation
  use gimp_smoothed_stress, only: smooth_stress
  use gimp_snapshot, only: order_t, order_particles, bring_in_order, sample_positions, sample_field, field_components
  use gimp_books, only: energy_residual, energy_drift, stress_update_error
  use gimp_run_state, only: stepper_t
  implicit none(type, external)
  private
  public :: recorder_t, open_recorder, record_frame, record_row, close_recorder, record_failure, next_frame_time
  public :: keep_record, unpack_record, continue_record

  integer, parameter :: most_columns = 160

  !> The open output of a run
  type :: recorder_t
    character(len=:), allocatable :: name, path
    type(output_file_t) :: output
    type(frames_t) :: frames
    type(history_t) :: history
    character(len=64), allocatable :: fields(:)
    integer(i8), allocatable :: body_first(:)
    integer(i8), allocatable :: probe(:) !! numbers of the particles that probes follow
    real(dp) :: every = 0.0_dp !! time between frames [s]; 0: first and last only
    integer :: history_every = 1
    integer :: frame = 0 !! frames written
    integer :: next_frame = 0 !! the next one is due at this multiple of `every`
    logical :: has_csv = .false.
    character(len=:), allocatable :: lineage !! who wrote the output file
    real(dp) :: frame_time = -1.0_dp !! of the last frame [s]
    integer(i8) :: row_step = -1 !! step of the last history row
    type(totals_t) :: totals
    type(errors_t) :: errors
    logical :: has_solution = .false.
    type(verification_t) :: solution
    character(len=32) :: column(most_columns) = "", unit(most_columns) = ""
    integer :: columns = 0
  end type recorder_t

contains

  !> Create the output file and announce what will be in it
  subroutine open_recorder(scene, s, solution, body_first, recorder, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in) :: s
    type(verification_t), intent(in) :: solution
    integer(i8), intent(in) :: body_first(:) !! first number of each body
    type(recorder_t), intent(out) :: recorder
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable :: complete
    call describe_recorder(scene, solution, body_first, recorder)
    call choose_probes(scene, s, recorder)
    call name_columns(s%engine%grid%dim, recorder)
    call open_output(recorder%path, logical_of(scene, "output", 1, "overwrite"), recorder%output, error)
    if (allocated(error)) return
    recorder%lineage = longer_lineage("", 0_i8)
    call share_text(0, recorder%lineage)
    call sign_output(recorder%output, recorder%lineage, error)
    if (allocated(error)) return
    call echo_scene(scene, complete)
    if (logical_of(scene, "output", 1, "overwrite")) then ! what is left of a run that is replaced would mislead
      if (this_rank == 0) call delete_leftovers(recorder%name, error)
      call share_error(error)
      if (allocated(error)) return
    end if
    call write_scene(recorder%output, scene%original, complete, error)
    if (allocated(error)) return
    call open_frames(recorder%output, word_of(scene, "output", 1, "precision"), recorder%frames, error)
    if (allocated(error)) return
    if (recorder%has_csv) then
      call open_history(recorder%output, recorder%column(:recorder%columns), recorder%unit(:recorder%columns), &
                        recorder%history, error, csv=csv_path(recorder))
    else
      call open_history(recorder%output, recorder%column(:recorder%columns), recorder%unit(:recorder%columns), &
                        recorder%history, error)
    end if
    if (allocated(error)) return
    call put_summary(recorder%output, "status", "running", error)
  end subroutine open_recorder

  !> Failed state and checkpoints of a run that is replaced
  subroutine delete_leftovers(name, error)
    character(len=*), intent(in) :: name
    type(error_t), allocatable, intent(out) :: error
    call delete_file(name//".failed.h5", error)
    if (.not. allocated(error)) call delete_file(newest_path(name), error)
    if (.not. allocated(error)) call delete_file(older_path(name), error)
  end subroutine delete_leftovers

  !> What the scene says about the output
  subroutine describe_recorder(scene, solution, body_first, recorder)
    type(scene_t), intent(in) :: scene
    type(verification_t), intent(in) :: solution
    integer(i8), intent(in) :: body_first(:)
    type(recorder_t), intent(inout) :: recorder
    recorder%name = text_of_key(scene, "output", 1, "name")
    recorder%path = recorder%name//".vtkhdf"
    recorder%every = real_of(scene, "output", 1, "every")
    recorder%history_every = integer_of(scene, "output", 1, "history_every")
    recorder%has_csv = logical_of(scene, "output", 1, "csv")
    recorder%fields = texts_of(scene, "output", 1, "fields")
    recorder%body_first = body_first
    recorder%solution = solution
    recorder%has_solution = solution%solution > 0
    recorder%lineage = ""
  end subroutine describe_recorder

  pure function csv_path(recorder) result(path)
    type(recorder_t), intent(in) :: recorder
    character(len=:), allocatable :: path
    path = recorder%name//".history.csv"
  end function csv_path

  !> Commit the history, wait for the device and pack what a later run must know to go on with the output
  subroutine keep_record(recorder, end, parcel, error)
    type(recorder_t), intent(inout) :: recorder
    real(dp), intent(in) :: end !! of the run [s]
    type(parcel_t), intent(inout) :: parcel
    type(error_t), allocatable, intent(out) :: error
    call commit_history(recorder%output, recorder%history, error)
    if (.not. allocated(error)) call sync_output(recorder%output, error)
    if (.not. allocated(error)) call carry_recorder(recorder, end, parcel)
  end subroutine keep_record

  !> A recorder from what the scene says and what was packed; nothing is opened yet
  subroutine unpack_record(scene, s, solution, body_first, parcel, recorder, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in) :: s !! as it was when the recorder was packed
    type(verification_t), intent(in) :: solution
    integer(i8), intent(in) :: body_first(:)
    type(parcel_t), intent(inout) :: parcel
    type(recorder_t), intent(out) :: recorder
    type(error_t), allocatable, intent(out) :: error
    call describe_recorder(scene, solution, body_first, recorder)
    call carry_recorder(recorder, s%time_options%end, parcel, now=s%time)
    if (.not. parcel%sound) return
    call name_columns(s%engine%grid%dim, recorder)
    parcel%sound = recorder%columns == recorder%history%columns
    if (.not. recorder%has_csv) return
    if (this_rank == 0) then
      if (file_bytes(csv_path(recorder)) < recorder%history%csv_bytes) &
        call raise(error, csv_path(recorder)//" is missing or shorter than it was; it must be there to be continued")
    end if
    call share_error(error)
  end subroutine unpack_record

  !> The list of what is kept of a recorder
  subroutine carry_recorder(recorder, end, parcel, now)
    type(recorder_t), intent(inout) :: recorder
    real(dp), intent(in) :: end !! of this run [s]
    type(parcel_t), intent(inout) :: parcel
    real(dp), intent(in), optional :: now !! unpacking: the present time [s]
    integer(i8) :: totals(storage_size(recorder%totals)/64), errors(storage_size(recorder%errors)/64)
    real(dp) :: every, end_then
    every = recorder%every
    end_then = end
    call carry(parcel, recorder%frame)
    call carry(parcel, recorder%next_frame)
    call carry(parcel, recorder%frame_time)
    call carry(parcel, every)
    call carry(parcel, end_then)
    call carry(parcel, recorder%row_step)
    call carry(parcel, recorder%probe)
    totals = transfer(recorder%totals, totals)
    errors = transfer(recorder%errors, errors)
    call carry_bits(parcel, totals)
    call carry_bits(parcel, errors)
    call carry_history(recorder%history, parcel)
    call carry_frames(recorder%frames, parcel)
    call carry_output(recorder%output, parcel)
    if (.not. present(now)) return
    recorder%totals = transfer(totals, recorder%totals)
    recorder%errors = transfer(errors, recorder%errors)
    if (recorder%every > 0.0_dp .and. (every /= recorder%every .or. end_then /= end)) & ! other times of frames from now on
      recorder%next_frame = floor(now/recorder%every + 1.0e-9_dp) + 1
  end subroutine carry_recorder

  !> Cut the output of an unpacked recorder back to where it was, and go on with it
  subroutine continue_record(recorder, step, lineage, error)
    type(recorder_t), intent(inout) :: recorder
    integer(i8), intent(in) :: step !! to which it is cut back
    character(len=*), intent(in) :: lineage !! of the checkpoint
    type(error_t), allocatable, intent(out) :: error
    recorder%lineage = longer_lineage(lineage, step)
    call share_text(0, recorder%lineage)
    call reopen_output(recorder%path, recorder%lineage, recorder%output, error)
    if (.not. allocated(error) .and. recorder%has_csv) call reopen_csv(recorder%history, csv_path(recorder), error)
    if (allocated(error)) return
    if (this_rank == 0) call delete_file(recorder%name//".failed.h5", error) ! of a failure after the checkpoint
    call share_error(error)
  end subroutine continue_record

  subroutine choose_probes(scene, s, recorder)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in) :: s
    type(recorder_t), intent(inout) :: recorder
    real(dp), allocatable :: points(:)
    integer :: d, k
    d = scene%dimension
    allocate (recorder%probe(0))
    if (.not. is_given(scene, "output", 1, "probes")) return
    points = reals_of(scene, "output", 1, "probes")
    do k = 1, size(points)/d
      recorder%probe = [recorder%probe, nearest_particle(s%engine, points(d*(k - 1) + 1:d*k), 1_i8, huge(1_i8))]
    end do
  end subroutine choose_probes

  !> The columns of the history
  subroutine name_columns(dim, recorder)
    integer, intent(in) :: dim
    type(recorder_t), intent(inout) :: recorder
    character(len=1), parameter :: axis(3) = ["x", "y", "z"]
    integer :: k, p
    call column("step", "1")
    call column("time", "s")
    call column("dt", "s")
    call column("dt_limit", "1")
    call column("kinetic_energy", "J")
    call column("stored_energy", "J")
    call column("plastic_dissipation", "J")
    call column("damping_dissipation", "J")
    call column("external_work", "J")
    call column("reaction_work", "J")
    call column("transfer_loss_p2g", "J")
    call column("transfer_loss_g2p", "J")
    call column("stress_update_error", "J")
    call column("removed_energy", "J")
    call column("energy_residual", "1")
    call column("energy_drift", "1")
    do k = 1, 3
      call column("momentum_"//axis(k), "kg m/s")
    end do
    do k = 1, 3
      call column("angular_momentum_"//axis(k), "kg m2/s")
    end do
    do k = 1, 3
      call column("reaction_"//axis(k), "N")
    end do
    call column("mass", "kg")
    call column("particles", "1")
    call column("max_speed", "m/s")
    call column("cut_nodes", "1")
    call column("clamped_domains", "1")
    call column("wide_chunks", "1")
    if (recorder%has_solution) then
      call column("error_rms", "1")
      call column("error_max", "1")
      call column("error_rms_velocity", "m/s")
      call column("error_rms_stress", "Pa")
    end if
    do p = 1, size(recorder%probe)
      do k = 1, dim
        call column("probe"//text_of(p)//"_"//axis(k), "m")
      end do
      do k = 1, dim
        call column("probe"//text_of(p)//"_velocity_"//axis(k), "m/s")
      end do
      call column("probe"//text_of(p)//"_stress_xx", "Pa")
      call column("probe"//text_of(p)//"_stress_yy", "Pa")
      call column("probe"//text_of(p)//"_stress_zz", "Pa")
      call column("probe"//text_of(p)//"_stress_xy", "Pa")
    end do

  contains

    subroutine column(name, unit)
      character(len=*), intent(in) :: name, unit
      recorder%columns = recorder%columns + 1
      recorder%column(recorder%columns) = name
      recorder%unit(recorder%columns) = unit
    end subroutine column

  end subroutine name_columns

  !> Time of the next frame [s]
  pure real(dp) function next_frame_time(recorder, end) result(time)
    type(recorder_t), intent(in) :: recorder
    real(dp), intent(in) :: end !! of the run [s]
    time = end
    if (recorder%every > 0.0_dp) time = min(end, recorder%next_frame*recorder%every)
  end function next_frame_time

  !> Measure and write one row of the history
  subroutine record_row(recorder, s, error)
    type(recorder_t), intent(inout) :: recorder
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: row(most_columns)
    real(dp) :: probes(probe_values(s%engine%grid%dim), size(recorder%probe))
    integer :: n
    if (recorder%row_step == s%step) return
    call measure_totals(s%engine, recorder%totals)
    s%books%stored = recorder%totals%stored
    if (s%step == 0) s%books%stored_start = recorder%totals%stored
    s%books%largest = max(s%books%largest, recorder%totals%stored)
    associate (b => s%books, t => recorder%totals)
      row(:16) = [real(s%step, dp), s%time, s%dt, real(s%limit, dp), b%kinetic, t%stored, b%plastic, &
                  b%damping, b%loads, b%reactions, b%loss_p2g, b%loss_g2p, stress_update_error(b), b%removed, &
                  energy_residual(b), energy_drift(b)]
      row(17:19) = t%momentum
      row(20:22) = t%angular_momentum
      row(23:25) = b%reaction
      row(26:31) = [t%mass, real(sum_counts(s%engine%particles%n), dp), t%speed, real(b%cut_nodes, dp), real(b%clamped, dp), &
                    real(b%wide_chunks, dp)]
    end associate
    n = 31
    if (recorder%has_solution) then
      call measure_errors(s%engine, recorder%solution, s%time, velocity_time(s), recorder%errors)
      row(n + 1:n + 4) = [recorder%errors%rms/error_scale(recorder%solution), recorder%errors%max/error_scale(recorder%solution), &
                          recorder%errors%rms_velocity, recorder%errors%rms_stress]
      n = n + 4
    end if
    call measure_probes(s%engine, recorder%probe, probes)
    row(n + 1:n + size(probes)) = reshape(probes, [size(probes)])
    n = n + size(probes)
    call append_row(recorder%output, recorder%history, row(:n), error)
    recorder%row_step = s%step
  end subroutine record_row

  !> Time at which the particles' velocities live: half a step back after a half-step start
  pure real(dp) function velocity_time(s)
    type(stepper_t), intent(in) :: s
    velocity_time = s%time
    if (s%method%half_start .and. s%step > 0) velocity_time = s%time - 0.5_dp*s%dt
  end function velocity_time

  !> Write one frame, with the history up to it
  subroutine record_frame(recorder, s, error)
    type(recorder_t), intent(inout) :: recorder
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    type(order_t) :: order
    real(dp), allocatable :: values(:, :)
    real(wp), allocatable :: smoothed(:, :, :) ! not present below unless made
    integer :: k
    if (recorder%frame_time == s%time) return
    call order_particles(s%engine, order)
    allocate (values(3, order%listed))
    call sample_positions(s%engine, order%slot, values)
    call bring_in_order(order, values)
    call begin_frame(recorder%output, recorder%frames, values, error, order%slab%before, order%slab%n)
    do k = 1, size(recorder%fields)
      if (allocated(error)) return
      if (recorder%fields(k) == "error" .and. .not. recorder%has_solution) cycle
      if (recorder%fields(k) == "smoothed_stress") call smooth_stress(s%engine, smoothed)
      deallocate (values)
      allocate (values(field_components(trim(recorder%fields(k))), order%listed))
      call sample_field(s%engine, trim(recorder%fields(k)), order%slot, recorder%body_first, recorder%solution, s%time, &
                        values, smoothed)
      call bring_in_order(order, values)
      call add_field(recorder%output, recorder%frames, trim(recorder%fields(k)), values, error)
    end do
    if (.not. allocated(error)) call commit_history(recorder%output, recorder%history, error)
    if (.not. allocated(error)) call end_frame(recorder%output, recorder%frames, s%time, error)
    recorder%frame_time = s%time
    recorder%frame = recorder%frame + 1
    recorder%next_frame = recorder%next_frame + 1
  end subroutine record_frame

  !> Close the output file
  subroutine close_recorder(recorder, error)
    type(recorder_t), intent(inout) :: recorder
    type(error_t), allocatable, intent(out) :: error
    type(error_t), allocatable :: problem
    call close_history(recorder%output, recorder%history, error)
    call close_output(recorder%output, problem) ! also after a failure: a file without a commit is taken away
    if (.not. allocated(error)) call move_alloc(problem, error)
  end subroutine close_recorder

  !> The state in which a run failed goes to NAME.failed.h5, as a particle file
  subroutine record_failure(recorder, s, reason, error)
    type(recorder_t), intent(in) :: recorder
    type(stepper_t), intent(in) :: s
    character(len=*), intent(in) :: reason
    type(error_t), allocatable, intent(out) :: error
    type(particle_table_t) :: table
    type(order_t) :: order
    real(dp), allocatable :: single(:, :) ! volume, mass, number
    call order_particles(s%engine, order)
    call sample_state(s%engine, order, table, single)
    call bring_in_order(order, table%position)
    call bring_in_order(order, table%velocity)
    call bring_in_order(order, table%deformation_gradient)
    call bring_in_order(order, table%stress)
    call bring_in_order(order, single)
    table%n = order%slab%mine
    table%volume = single(1, :)
    table%mass = single(2, :)
    table%id = int(single(3, :), i8)
    call write_particle_file(recorder%name//".failed.h5", table, error, reason=reason, step=s%step, time=s%time)
  end subroutine record_failure

  !> State of this rank's particles
  subroutine sample_state(engine, order, table, single)
    type(engine_t), intent(in) :: engine
    type(order_t), intent(in) :: order
    type(particle_table_t), intent(out) :: table !! what has several components
    real(dp), allocatable, intent(out) :: single(:, :) !! volume, mass and number
    real(dp) :: x(lanes, 3)
    real(wp) :: f(lanes, 9), sigma(lanes, 6), j(lanes)
    integer :: g, c, l, d, i, k
    d = engine%grid%dim
    table%dimension = d
    allocate (table%position(d, order%listed), table%velocity(d, order%listed), table%deformation_gradient(d*d, order%listed), &
              table%stress(6, order%listed), single(3, order%listed))
    associate (p => engine%particles)
      do g = 1, size(p%groups)
        do c = p%groups(g)%first, p%groups(g)%last
          call chunk_position(engine, p%groups(g), c, x)
          call chunk_deformation(p, c, f)
          call chunk_stress(engine, p%groups(g), c, sigma, j)
          do l = 1, lanes
            if (order%slot(l, c) == 0) cycle
            associate (q => order%slot(l, c))
              table%position(:, q) = x(l, :d)
              table%velocity(:, q) = p%p(l, p%velocity%first:p%velocity%first + d - 1, c)
              table%stress(:, q) = sigma(l, :)
              single(:, q) = [real(dp) :: j(l)*p%p(l, p%volume%first, c), p%p(l, p%mass%first, c), p%id(l, c)]
              do i = 1, d
                do k = 1, d
                  table%deformation_gradient(d*(i - 1) + k, q) = f(l, 3*(i - 1) + k)
                end do
              end do
            end associate
          end do
        end do
      end do
    end associate
  end subroutine sample_state

end module gimp_recorder
