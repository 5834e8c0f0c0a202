!> What a step asks of the particles: a pass over them with its peaks, counts and failures, or a sort
module gimp_particle_stage
  use gimp_kinds, only: dp, i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_timer, only: seconds_now
  use gimp_ranks, only: this_rank, ranks
  use gimp_over_ranks, only: sum_counts, largest_count, share_text
  use gimp_basis, only: basis_ddmp
  use gimp_engine, only: pass_t, sum_external, sum_plastic, sum_clamped, sum_wide, sum_detached, sum_impulse, sum_handed, sum_handed_impulse, sum_visits, sum_beyond, peak_rate, peak_speed, peak_strain, &
    engine_t, fate_fine, fate_inverted, fate_outside, fate_jumped, fate_far, sign_failed, sign_inside, sign_restless, sign_spills
  use gimp_mesh, only: kind_name
  use gimp_search, only: found_t, find_element
  use gimp_particle_pass, only: particle_pass
  use gimp_cell_pass, only: evens_strain, evens_stress, rates_to_cells, stress_to_cells
  use gimp_resort, only: sort_particles
  use gimp_null_space, only: filter_velocities
  use gimp_run_state, only: stepper_t, hands_on, newmark, find_held, usl, musl, phase_particles, phase_sort
  implicit none(type, external)
  private
  public :: run_pass, give_pass, state_pass, resort, filter_null_space


contains

  !> Run a pass with the sums over cells that it needs. Where forces take the stress of cells, all particles are strained and moved
  !> before the first of them gives a force.
  subroutine run_pass(s, pass, error)
    type(stepper_t), intent(inout) :: s
    type(pass_t), intent(in) :: pass
    type(error_t), allocatable, intent(out) :: error
    type(pass_t) :: part
    if (pass%strain .and. evens_strain(s%engine)) call time_cells(s, pass)
    if (.not. (pass%force .and. evens_stress(s%engine))) then
      call run_one_pass(s, pass, error)
      return
    end if
    if (pass%velocity .or. pass%position .or. pass%strain) then
      part = pass
      part%momentum = .false.
      part%force = .false.
      call run_one_pass(s, part, error)
      if (allocated(error)) return
    end if
    call time_cells(s)
    part = pass
    part%velocity = .false.
    part%position = .false.
    part%strain = .false.
    call run_one_pass(s, part, error)
  end subroutine run_pass

  !> Sums over cells for a strain, without a pass for a force
  subroutine time_cells(s, pass)
    type(stepper_t), intent(inout) :: s
    type(pass_t), intent(in), optional :: pass
    real(dp) :: start
    start = seconds_now()
    if (present(pass)) then
      call rates_to_cells(s%engine, pass)
    else
      call stress_to_cells(s%engine)
    end if
    s%seconds(phase_particles) = s%seconds(phase_particles) + seconds_now() - start
  end subroutine time_cells

  !> Run a pass, note its peaks and counts, and make an error of the worst particle's fate
  subroutine run_one_pass(s, pass, error)
    type(stepper_t), intent(inout) :: s
    type(pass_t), intent(in) :: pass
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: start
    start = seconds_now()
    call particle_pass(s%engine, pass)
    s%seconds(phase_particles) = s%seconds(phase_particles) + seconds_now() - start
    associate (engine => s%engine)
      if (engine%told(sign_failed) > 0.0_dp) then
        call tell_worst(s, error)
        if (s%time_options%redo .and. .not. engine%told(sign_inside) > 0.0_dp) s%hopeless = walked_out(s)
        return
      end if
      if (pass%force) s%rate = sqrt(engine%told(peak_rate))
      if (pass%momentum) s%speed = sqrt(engine%told(peak_speed))
      if (pass%strain) s%strain_rate = sqrt(engine%told(peak_strain))
      s%sums = engine%all_sums
      s%books%plastic = s%books%plastic + s%sums(sum_plastic)
      if (.not. pass%own_kick) then ! such passes tell powers, which their integrator books
        s%books%work_external = s%books%work_external + s%sums(sum_external)
        s%books%impulse = s%books%impulse + s%sums(sum_impulse:sum_impulse + 2)
      end if
      s%books%clamped = s%books%clamped + nint(s%sums(sum_clamped), i8)
      s%books%detached = s%books%detached + nint(s%sums(sum_detached), i8)
      s%books%wide_chunks = s%books%wide_chunks + nint(s%sums(sum_wide), i8)
      s%books%search = s%books%search + nint(s%sums(sum_visits:sum_beyond), i8)
      s%books%handed = s%books%handed + nint(s%sums(sum_handed), i8)
      s%books%handed_impulse = s%books%handed_impulse + s%sums(sum_handed_impulse)
      if (engine%told(sign_spills) > 0.0_dp) s%books%spilled = s%books%spilled &
        + sum_counts(count(engine%spill%block(:engine%spill%n) <= engine%table%blocks, kind=i8))
      if (pass%momentum .or. pass%force) s%sort_now = s%sort_now .or. engine%told(sign_restless) > 0.0_dp
    end associate
  end subroutine run_one_pass

  !> The pass that brings particles to the grid for the next step
  pure type(pass_t) function give_pass(s, time)
    type(stepper_t), intent(in) :: s
    real(dp), intent(in) :: time
    give_pass%momentum = .true.
    give_pass%force = (s%method%scheme == usl .or. s%method%scheme == musl) .and. .not. hands_on(s%method)
    give_pass%time = time
  end function give_pass

  !> The pass that fills the pads as they are between two steps
  pure type(pass_t) function state_pass(s, time)
    type(stepper_t), intent(in) :: s
    real(dp), intent(in) :: time
    state_pass = give_pass(s, time)
    if (s%method%integrator /= newmark) return
    state_pass%force = .false.
    state_pass%inertia = .true.
  end function state_pass

  !> The message for the first particle that went wrong, in the order of blocks; all ranks get it
  subroutine tell_worst(s, error)
    type(stepper_t), intent(in) :: s
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable :: message
    integer(i8) :: key, first, root
    integer :: b
    b = findloc(s%engine%fate(1, :) /= fate_fine, .true., dim=1)
    key = huge(key)
    if (b > 0) key = s%engine%table%block_code(b)
    first = key
    if (ranks > 1) first = -largest_count(-key)
    message = ""
    if (b > 0 .and. key == first) call tell_fate(s, b, message)
    if (ranks > 1) then
      root = largest_count(merge(int(this_rank, i8), -1_i8, b > 0 .and. key == first))
      call share_text(int(root), message)
    end if
    call raise(error, message)
  end subroutine tell_worst

  !> The message for a particle that went wrong
  subroutine tell_fate(s, b, message)
    type(stepper_t), intent(in) :: s
    integer, intent(in) :: b
    character(len=:), allocatable, intent(out) :: message
    character(len=:), allocatable :: where, why
    real(dp) :: x
    integer :: c, l, k
    c = s%engine%fate(2, b)
    l = s%engine%fate(3, b)
    where = ""
    do k = 1, s%engine%grid%dim
      x = s%engine%grid%lower(k) + s%engine%grid%spacing &
          *(real(s%engine%particles%p(l, k, c), dp) + s%engine%table%block_at(k, b)*s%engine%grid%edge(k))
      if (k > 1) where = where//","
      where = where//" "//text_of(x)
    end do
    select case (s%engine%fate(1, b))
    case (fate_inverted); why = "its deformation gradient has no positive determinant (the particle is inverted)"
    case (fate_outside)
      why = "it has left the grid"
      if (s%engine%grid%open_degree > 0) why = "it has left the box, where open-knot splines end (spline_boundary = 'ghost' goes on)"
      if (s%engine%basis == basis_ddmp) why = "it has left the box, where the smeared gradients of ddmp end"
      if (s%engine%grid%is_mesh) why = "it has left the mesh"//side_crossed(s%engine, c, l)
    case (fate_jumped)
      why = "it moved by more than a block in one step"
      if (s%engine%grid%is_mesh) why = "it moved by more than an element in one step"
    case (fate_far)
      why = "its domain reaches beyond the elements around its patch (domain_limit in &method shortens domains; more particles make them smaller)"
    case default; why = "its position or deformation is not a number"
    end select
    message = "step "//text_of(s%step + 1)//", t = "//text_of(s%time)//" s, dt = "//text_of(s%dt)//" s: particle " &
               //text_of(s%engine%particles%id(l, c))//" at"//where//" m: "//why
  end subroutine tell_fate

  !> Through which side of the mesh a particle left it, in words
  function side_crossed(engine, c, l) result(words)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: c, l !! chunk, lane
    character(len=:), allocatable :: words
    type(found_t) :: found
    integer :: d, e
    d = engine%grid%dim
    associate (p => engine%particles%p(l, :, c), v => engine%particles%velocity%first)
      call find_element(engine%mesh, engine%locator, engine%search_rule, p(:d), p(v:v + d - 1), abs(nint(p(engine%particles%element%first))), found)
    end associate
    words = ""
    if (found%side == 0) return
    e = engine%mesh%side_element(found%side)
    words = " through a side without a name"
    if (engine%mesh%side_group(found%side) > 0) words = " through side '"//trim(engine%mesh%side_group_name(engine%mesh%side_group(found%side)))//"'"
    words = words//" of "//trim(kind_name(engine%mesh%kind(e)))//" element "//text_of(engine%mesh%element_in_file(e)) &
            //" (a &boundary with a condition holds it back, condition = 'free' with leaving = 'remove' takes it out)"
  end function side_crossed

  !> Whether the particles that left the grid did so at less than a cell per step: then they go there with any step
  pure logical function walked_out(s)
    type(stepper_t), intent(in) :: s
    walked_out = s%dt*sqrt(s%engine%told(peak_speed)) < s%engine%grid%spacing
  end function walked_out

  !> Sort, and renew what hangs on the tables of blocks
  subroutine resort(s, leaving)
    type(stepper_t), intent(inout) :: s
    logical, allocatable, intent(inout), optional :: leaving(:, :) !! (lane, chunk); used up
    real(dp) :: start
    start = seconds_now()
    call sort_particles(s%engine, leaving)
    call find_held(s)
    s%sort_now = .false.
    s%books%sorts = s%books%sorts + 1
    s%seconds(phase_sort) = s%seconds(phase_sort) + seconds_now() - start
  end subroutine resort

  !> Take out of the velocities what the nodes do not see. The particles were just sorted. The energy is lost on the way back from the
  !> grid, since the books see what particles give next; it is counted apart as well.
  subroutine filter_null_space(s)
    type(stepper_t), intent(inout) :: s
    real(dp) :: taken, start
    start = seconds_now()
    call filter_velocities(s%engine, taken)
    s%books%filtered = s%books%filtered + taken
    s%seconds(phase_particles) = s%seconds(phase_particles) + seconds_now() - start
  end subroutine filter_null_space

end module gimp_particle_stage
