!> What a step asks of the nodes: they add the pads of blocks, spills, loads and images, obey the equation of motion
!> (gimp_nodes), and the sums of it go into the books.
module gimp_nodal_stage
  use gimp_kinds, only: wp, dp
  use gimp_timer, only: seconds_now
  use gimp_over_ranks, only: sum_columns
  use gimp_grid, only: nodes_per_block, nf => fields_per_node, node_mass, has_images
  use gimp_blocks, only: few_blocks
  use gimp_images, only: note_images, fold_images, copy_images
  use gimp_engine, only: sum_affine
  use gimp_pads, only: sum_pads, add_spills
  use gimp_loads, only: gravity_at, has_loads, collect_loads, add_loads, work_of_loads, sum_of_loads
  use gimp_nodes, only: update_nodes, node_step_t, stage_full, stage_velocity, stage_kick, stage_project, n_node_sums, &
    book_before, book_after, book_given, book_forces, book_gravity, book_walls, book_damping, book_cut, book_cut_momentum, &
    book_reaction, book_pushed, book_impulse, book_held
  use gimp_books, only: books_t
  use gimp_run_state, only: stepper_t, flip_now, damping_local, phase_grid
  implicit none(type, external)
  private
  public :: nodal_stage, collect_pads, remember_images, book_images, book_stage, copy_masses, sum_slots


contains

  !> Nodes add their pads and obey the equation of motion
  subroutine nodal_stage(s, stage, kick)
    type(stepper_t), intent(inout) :: s
    integer, intent(in) :: stage
    real(dp), intent(in) :: kick
    type(node_step_t) :: step
    real(dp), allocatable :: part(:, :) ! (n_node_sums, slot)
    real(dp) :: sums(n_node_sums), start
    real(wp) :: raw(nf, nodes_per_block)
    real(dp) :: turned(3)
    integer :: slot, lost
    logical :: loaded, at_once

    start = seconds_now()
    step = node_step_t(stage=stage, kick=real(kick, wp), gravity=real(gravity_at(s%loads, s%time), wp), cutoff=s%cutoff_mass, round_off=s%round_off_mass, &
                       pic=1.0_wp - flip_now(s), light=s%light_mass)
    if (s%method%damping == damping_local) step%damping = s%method%damping_factor
    loaded = .false.
    if (stage == stage_full .or. stage == stage_kick) then
      call collect_loads(s%loads, s%engine, s%time)
      loaded = has_loads(s%loads)
    end if
    at_once = .not. (loaded .or. s%engine%spill%n > 0 .or. has_images(s%engine%grid))
    allocate (part(n_node_sums, s%engine%table%slots))
    associate (engine => s%engine, table => s%engine%table)
      if (at_once) then
        !$omp parallel do schedule(dynamic, 16) private(raw) if(table%slots > few_blocks)
        do slot = 1, table%slots
          call sum_pads(engine, slot, raw)
          call update_nodes(step, engine%grid, s%walls, s%held(slot), table%slot_at(:, slot), raw, engine%g(:, :, slot), &
                            part(:, slot))
        end do
        !$omp end parallel do
      else
        call collect_pads(s)
        call remember_images(s, stage)
        call fold_images(engine%images, table%slots, s%raw)
        if (loaded) then
          lost = 0
          if (stage == stage_full) call copy_masses(s) ! the kick finds the masses there already
          call add_loads(s%loads, engine, table%slots, engine%g, s%cutoff_mass, s%raw, lost, turned)
          s%books%lost_loads = s%books%lost_loads + lost
        end if
        !$omp parallel do schedule(static) if(table%slots > few_blocks)
        do slot = 1, table%slots
          call update_nodes(step, engine%grid, s%walls, s%held(slot), table%slot_at(:, slot), s%raw(:, :, slot), &
                            engine%g(:, :, slot), part(:, slot))
        end do
        !$omp end parallel do
        call copy_images(engine%images, table%slots, engine%g)
      end if
      if (loaded) s%books%impulse = s%books%impulse + kick*(sum_of_loads(s%loads) + turned)
      if (loaded) s%books%work_external = s%books%work_external + work_of_loads(s%loads, engine, table%slots, engine%g, kick, 0.5_wp)
    end associate
    if (stage /= stage_project) then ! which is not booked
      call sum_slots(s, part, sums)
      sums(book_given) = sums(book_given) + s%sums(sum_affine) ! not a field of the nodes
      call book_stage(s%books, stage, kick, 1.0_dp - flip_now(s), sums)
      if (loaded) s%books%reaction = s%books%reaction + turned
    end if
    if (has_images(s%engine%grid) .and. (stage == stage_full .or. stage == stage_kick)) call book_images(s, kick)
    s%seconds(phase_grid) = s%seconds(phase_grid) + seconds_now() - start

  end subroutine nodal_stage

  !> Sums over all slots, each counted by one rank. Collective
  subroutine sum_slots(s, part, sums)
    type(stepper_t), intent(in) :: s
    real(dp), intent(inout) :: part(:, :) !! (quantity, slot)
    real(dp), intent(out) :: sums(:)
    integer :: slot
    do slot = 1, s%engine%table%slots
      if (.not. s%engine%table%booked(slot)) part(:, slot) = 0.0_dp
    end do
    call sum_columns(part, sums)
  end subroutine sum_slots

  !> Sums of all pads and spills at once, in `s%raw`
  subroutine collect_pads(s)
    type(stepper_t), intent(inout) :: s
    integer :: slot
    associate (slots => s%engine%table%slots)
      if (allocated(s%raw)) then
        if (size(s%raw, 3) /= slots) deallocate (s%raw)
      end if
      if (.not. allocated(s%raw)) allocate (s%raw(nf, nodes_per_block, slots))
      !$omp parallel do schedule(dynamic, 16) if(slots > few_blocks)
      do slot = 1, slots
        call sum_pads(s%engine, slot, s%raw(:, :, slot))
      end do
      !$omp end parallel do
      call add_spills(s%engine, slots, s%raw)
    end associate
  end subroutine collect_pads

  !> Nodes find their masses, which loads ask for before the update
  subroutine copy_masses(s)
    type(stepper_t), intent(inout) :: s
    integer :: k
    !$omp parallel do schedule(static) if(s%engine%table%slots > few_blocks)
    do k = 1, s%engine%table%slots
      s%engine%g(node_mass, :, k) = s%raw(node_mass, :, k)
    end do
    !$omp end parallel do
  end subroutine copy_masses

  !> Keep what images were given: momentum and mass from the first stage of a step, forces from the one that has them
  subroutine remember_images(s, stage)
    type(stepper_t), intent(inout) :: s
    integer, intent(in) :: stage
    real(wp) :: held(nf, size(s%engine%images))
    if (stage == stage_project .or. size(s%engine%images) == 0) return
    call note_images(s%engine%images, s%engine%table%slots, s%raw, held)
    if (stage /= stage_kick) then
      s%at_images = held
    else
      s%at_images(5:7, :) = held(5:7, :)
    end if
  end subroutine remember_images

  !> A mirror turns around the normal momentum and force that its images were given, and what they give back: its reaction
  subroutine book_images(s, kick)
    type(stepper_t), intent(inout) :: s
    real(dp), intent(in) :: kick
    real(dp) :: impulse(3), pic
    real(dp), allocatable :: part(:, :) ! (axis, image)
    integer :: k
    allocate (part(3, size(s%engine%images)), source=0.0_dp)
    pic = 1.0_dp - flip_now(s)
    do k = 1, size(s%engine%images)
      if (.not. s%engine%table%booked(s%engine%images(k)%slot)) cycle
      associate (i => s%engine%images(k), given => s%at_images(:, k))
        associate (target => s%engine%g(:, i%target_place, i%target_slot))
          part(:, k) = -(1.0_dp - i%sign(1:3))*(kick*given(5:7) + given(4)*target(5:7) &
                                                + pic*(given(1:3) + given(4)*(target(1:3) - target(5:7))))
        end associate
      end associate
    end do
    call sum_columns(part, impulse)
    s%books%impulse = s%books%impulse + impulse
    s%books%reaction = s%books%reaction + impulse/kick
  end subroutine book_images

  !> Carry the sums of a stage into the books
  pure subroutine book_stage(books, stage, kick, pic, sums)
    type(books_t), intent(inout) :: books
    integer, intent(in) :: stage
    real(dp), intent(in) :: kick
    real(dp), intent(in) :: pic !! share of PIC: only so much of the held velocity reaches the particles
    real(dp), intent(in) :: sums(n_node_sums)
    if (stage == stage_full .or. stage == stage_velocity) then
      books%given = sums(book_given)
      books%work_pushed = pic*sums(book_pushed)
      books%cut_nodes = books%cut_nodes + nint(sums(book_cut), kind(books%cut_nodes))
      books%cut_momentum = books%cut_momentum + sums(book_cut_momentum)
      if (stage == stage_velocity) books%impulse = books%impulse + sums(book_impulse:book_impulse + 2)
      books%reaction = pic*sums(book_held:book_held + 2)/kick
      books%impulse = books%impulse + pic*sums(book_held:book_held + 2)
    end if
    if (stage == stage_full .or. stage == stage_kick) then
      books%grid_before = sums(book_before)
      books%grid_after = sums(book_after)
      books%work_forces = sums(book_forces)
      books%work_gravity = sums(book_gravity)
      books%work_walls = sums(book_walls)
      books%work_damping = sums(book_damping)
      books%reaction = books%reaction + sums(book_reaction:book_reaction + 2)/kick
      books%impulse = books%impulse + sums(book_reaction:book_reaction + 2) + sums(book_impulse:book_impulse + 2)
    end if
  end subroutine book_stage

end module gimp_nodal_stage
