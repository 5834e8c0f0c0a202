!> XPIC(m) (Hammerquist & Nairn 2017) and FMPM(k) (Nairn & Hammerquist 2021): particle velocities from a series on the grid,
!>
!>     v* = sum over j < k of (I - S+ S)^j w,    S+ u = (sum_p S m_p u_p)/m,
!>
!> which tends to the inverse of the consistent mass matrix as k grows. FMPM takes w = v+, the velocity after forces and
!> conditions, and v_p' = S v*; XPIC takes w = v, that before, and v_p' = S (v* + v+ - v). Each term is one pass over the
!> particles: dv <- dv - S+ S dv. Sides hold the terms by their conditions on changes: a given velocity does not change.
!>
!> Fields of the grid meanwhile: 1-3 the term dv; 5-7 v+ once the first pass is over. `star` holds the sum.
module gimp_series
  use gimp_kinds, only: wp, dp
  use gimp_error, only: error_t
  use gimp_timer, only: seconds_now
  use gimp_over_ranks, only: sum_columns
  use gimp_grid, only: grid_t, node_at_place, nodes_per_block, nf => fields_per_node, node_mass, has_images
  use gimp_blocks, only: few_blocks
  use gimp_images, only: fold_images, copy_images
  use gimp_engine, only: pass_t, motion_grid, motion_mean, motion_change
  use gimp_pads, only: sum_pads
  use gimp_walls, only: walls_t, constrain_change
  use gimp_run_state, only: stepper_t, in_series, usl, series_xpic, position_grid, position_published, phase_grid
  use gimp_particle_stage, only: run_pass
  use gimp_nodal_stage, only: collect_pads, sum_slots
  implicit none(type, external)
  private
  public :: note_series, smooth_velocity, smooth_strain


contains

  !> What the passes of this step do otherwise than with FLIP: whence new velocities come, and what moves particles
  pure subroutine note_series(s, pass)
    type(stepper_t), intent(in) :: s
    type(pass_t), intent(inout) :: pass
    logical :: first
    if (.not. in_series(s)) return
    first = s%method%strain_by_series .and. s%method%scheme == usl ! v* stands where strains come from, v+ second
    if (s%method%order > 1) pass%replaced_by = merge(1, 5, first)
    pass%moved_by_second = first
    pass%moved_by_particle = s%method%position /= position_grid
    if (s%method%position == position_published) &
      pass%motion = merge(motion_change, motion_mean, s%method%series == series_xpic)
  end subroutine note_series

  !> After the kick: v* of the particles into fields 5-7, v+ stays in 1-3 (the other way round for USL with strains from v*)
  subroutine smooth_velocity(s, kick, error)
    type(stepper_t), intent(inout) :: s
    real(dp), intent(in) :: kick !! [s]
    type(error_t), allocatable, intent(out) :: error
    type(pass_t) :: pass
    logical :: xpic, notes
    integer :: j
    if (.not. in_series(s)) return
    xpic = s%method%series == series_xpic
    notes = xpic .and. s%method%position == position_published ! S v, in the first pass
    if (s%method%order == 1 .and. .not. notes) return
    call begin_sum(s, xpic)
    do j = 1, max(s%method%order - 1, 1)
      ! fields 5-7 are +-(v+ - v) in the first pass: so it knows the work of external forces with the mean velocity
      pass = pass_t(smooth=.true., old_weights=.true., kick=real(kick, wp), external=j == 1 .and. s%method%order > 1)
      if (j == 1 .and. notes) pass%motion = motion_grid
      call run_pass(s, pass, error)
      if (allocated(error)) return
      if (s%method%order > 1) call next_term(s, kick, keep_second=j > 1, book=.true.)
    end do
    if (s%method%order == 1) then
      call end_of_notes(s)
    else
      call end_sum(s, first=s%method%strain_by_series .and. s%method%scheme == usl)
    end if
  end subroutine smooth_velocity

  !> After the projection of MUSL: the velocity that strains come from, to the same order; fields 5-7 stay
  subroutine smooth_strain(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    integer :: j
    if (.not. (in_series(s) .and. s%method%strain_by_series) .or. s%method%order == 1) return
    call begin_sum(s, .false.)
    do j = 1, s%method%order - 1
      call run_pass(s, pass_t(smooth=.true., old_weights=.true.), error)
      if (allocated(error)) return
      call next_term(s, 1.0_dp, keep_second=.true., book=.false.)
    end do
    call end_sum(s, first=.true.)
  end subroutine smooth_strain

  !> The sum starts with the velocity in fields 1-3, v+; so do the terms, or (XPIC) with v, and then fields 5-7 change their sign
  subroutine begin_sum(s, before_kick)
    type(stepper_t), intent(inout) :: s
    logical, intent(in) :: before_kick
    integer :: slot
    associate (g => s%engine%g, slots => s%engine%table%slots)
      if (allocated(s%star)) then
        if (size(s%star, 3) /= slots) deallocate (s%star, s%star_impulse)
      end if
      if (.not. allocated(s%star)) allocate (s%star(3, nodes_per_block, slots), s%star_impulse(6, slots))
      !$omp parallel do schedule(static) if(slots > few_blocks)
      do slot = 1, slots
        s%star(:, :, slot) = g(1:3, :, slot)
        if (.not. before_kick) cycle
        g(1:3, :, slot) = g(1:3, :, slot) - g(5:7, :, slot)
        g(5:7, :, slot) = -g(5:7, :, slot)
      end do
      !$omp end parallel do
    end associate
  end subroutine begin_sum

  !> dv <- dv - S+ S dv from what the particles gave in a smoothing pass, and its part in the sum
  subroutine next_term(s, kick, keep_second, book)
    type(stepper_t), intent(inout) :: s
    real(dp), intent(in) :: kick !! [s]
    logical, intent(in) :: keep_second !! fields 5-7 stay; else they become the sum so far
    logical, intent(in) :: book !! particles will feel it
    real(wp) :: raw(nf, nodes_per_block)
    real(dp) :: sums(6), impulse(3), back(3), start
    logical :: at_once
    integer :: slot
    start = seconds_now()
    impulse = 0.0_dp
    at_once = .not. (s%engine%spill%n > 0 .or. has_images(s%engine%grid))
    associate (engine => s%engine, slots => s%engine%table%slots)
      if (.not. at_once) then
        call collect_pads(s)
        if (book .and. has_images(engine%grid)) call turn_around(s, given=.true., momentum=impulse)
        call fold_images(engine%images, slots, s%raw)
      end if
      !$omp parallel do schedule(dynamic, 16) private(raw) if(slots > few_blocks)
      do slot = 1, slots
        if (at_once) then
          call sum_pads(engine, slot, raw)
        else
          raw = s%raw(:, :, slot)
        end if
        if (.not. keep_second) engine%g(5:7, :, slot) = s%star(:, :, slot)
        call subtract(engine%grid, s%walls, s%held(slot), engine%table%slot_at(:, slot), raw, engine%g(:, :, slot), &
                      s%star_impulse(:, slot))
        s%star(:, :, slot) = s%star(:, :, slot) + engine%g(1:3, :, slot)
      end do
      !$omp end parallel do
      if (.not. at_once) call copy_images(engine%images, slots, engine%g)
    end associate
    if (book) then
      if (has_images(s%engine%grid)) then
        call turn_around(s, given=.false., momentum=back)
        impulse = impulse - back
      end if
      call sum_slots(s, s%star_impulse, sums)
      impulse = impulse + sums(4:6)
      s%books%reaction = s%books%reaction + impulse/kick
      s%books%impulse = s%books%impulse + impulse + sums(1:3)
    end if
    s%seconds(phase_grid) = s%seconds(phase_grid) + seconds_now() - start
  end subroutine next_term

  !> One slot: dv <- dv - raw/m. Nodes without mass drop what they were given, sides hold the change
  pure subroutine subtract(grid, walls, held, at, raw, g, impulse)
    type(grid_t), intent(in) :: grid
    type(walls_t), intent(in) :: walls
    logical, intent(in) :: held !! some node of the slot is on a side or beyond
    integer, intent(in) :: at(3) !! block coordinates
    real(wp), intent(in) :: raw(nf, nodes_per_block) !! momentum m S dv in fields 1-3
    real(wp), intent(inout) :: g(nf, nodes_per_block)
    real(dp), intent(out) :: impulse(6) !! 1-3: of cut nodes, 4-6: of the sides [kg m/s]
    real(wp) :: dv(3)
    integer :: i
    impulse = 0.0_dp
    do i = 1, nodes_per_block
      if (g(node_mass, i) <= 0.0_wp) then
        impulse(1:3) = impulse(1:3) + real(raw(1:3, i), dp)
        cycle
      end if
      dv = g(1:3, i) - raw(1:3, i)/g(node_mass, i)
      g(1:3, i) = dv
      if (.not. held) cycle
      call constrain_change(walls, grid, node_at_place(grid, at, i), g(1:3, i))
      impulse(4:6) = impulse(4:6) + real(g(node_mass, i)*(g(1:3, i) - dv), dp)
    end do
  end subroutine subtract

  !> Momentum that mirrors turn around: of what their images were given by particles (if `given`), and of what the present term
  !> gives back through them [kg m/s]
  subroutine turn_around(s, given, momentum)
    type(stepper_t), intent(in) :: s
    logical, intent(in) :: given
    real(dp), intent(out) :: momentum(3)
    real(dp) :: part(3, size(s%engine%images))
    integer :: k
    part = 0.0_dp
    do k = 1, size(s%engine%images)
      if (.not. s%engine%table%booked(s%engine%images(k)%slot)) cycle
      associate (i => s%engine%images(k))
        part(:, k) = (1.0_dp - i%sign(1:3))*s%at_images(node_mass, k)*s%engine%g(1:3, i%target_place, i%target_slot)
        if (given) part(:, k) = part(:, k) + (1.0_dp - i%sign(1:3))*s%raw(1:3, i%place, i%slot)
      end associate
    end do
    call sum_columns(part, momentum)
  end subroutine turn_around

  !> The sum goes where particles look for it
  subroutine end_sum(s, first)
    type(stepper_t), intent(inout) :: s
    logical, intent(in) :: first !! into fields 1-3, and 5-7 stay; else into 5-7, and v+ from there into 1-3
    integer :: slot
    associate (g => s%engine%g, slots => s%engine%table%slots)
      !$omp parallel do schedule(static) if(slots > few_blocks)
      do slot = 1, slots
        if (first) then
          g(1:3, :, slot) = s%star(:, :, slot)
        else
          g(1:3, :, slot) = g(5:7, :, slot)
          g(5:7, :, slot) = s%star(:, :, slot)
        end if
      end do
      !$omp end parallel do
      if (has_images(s%engine%grid)) call copy_images(s%engine%images, slots, g)
    end associate
  end subroutine end_sum

  !> XPIC(1) is PIC; its pass only noted S v
  subroutine end_of_notes(s)
    type(stepper_t), intent(inout) :: s
    integer :: slot
    associate (g => s%engine%g, slots => s%engine%table%slots)
      !$omp parallel do schedule(static) if(slots > few_blocks)
      do slot = 1, slots
        g(1:3, :, slot) = s%star(:, :, slot)
        g(5:7, :, slot) = -g(5:7, :, slot)
      end do
      !$omp end parallel do
    end associate
  end subroutine end_of_notes

end module gimp_series
