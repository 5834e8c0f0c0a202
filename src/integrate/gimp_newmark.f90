!> Explicit Newmark predictor-corrector (beta = 0), with the weights of the new positions:
!>
!>   u = sum m S (v_p + dt/2 a_p) / m_i,   x_p += dt S u,   L = grad(u),   v_p += (1 - gamma) dt a_p
!>   at the new positions:   a_i = f/m_i,   a_p = S a_i,   v_p += gamma dt a_p
!>
!> First of all a_p = S (f/m) at t = 0. gamma = 1/2 is the trapezoidal rule, the same as leap-frog for equal steps, with velocities
!> of the end of the step; more damps, and is of first order. Limit: omega dt = sqrt(2/gamma) (a mode of which the particles keep
!> the share p bears 1/sqrt(p) times as much: its stiffness is strained by what has been through the particles, as in MUSL).
!>
!> A step ends with pads that hold mass, m v_p and m a_p (in the place of forces): the next one begins with its u.
!>
!> Books. a_p = S a_i with the weights of the pads, so the kick c a_p of all particles changes their kinetic energy by exactly
!>   c sum m_i a_i . v_i +- c^2/2 sum m_i a_i . b_i,   v_i, b_i: velocities and accelerations of the particles on the grid,
!> and m_i a_i are forces, gravity, damping and sides. Their powers P = F . v_i and F . b_i are found once, at the end of a step; the
!> corrector (c = gamma dt, minus) is booked at once, the predictor (plus) when the next step is known. Where a side holds a component,
!> forces and side do work with what it allows of v_i and b_i, and the rest counts as lost on the way to the grid; nothing else is.
module gimp_newmark
  use gimp_kinds, only: wp, dp
  use gimp_error, only: error_t
  use gimp_timer, only: seconds_now
  use gimp_grid, only: node_at_place, nodes_per_block, has_images
  use gimp_blocks, only: few_blocks
  use gimp_images, only: fold_images, copy_images
  use gimp_engine, only: pass_t, sum_external, sum_impulse
  use gimp_walls, only: walls_t, move_walls, constrain
  use gimp_loads, only: gravity_at, has_loads, collect_loads, add_loads, work_of_loads, sum_of_loads
  use gimp_nodes, only: stage_full, sign_or_zero
  use gimp_run_state, only: stepper_t, damping_local, phase_grid, power_forces, power_gravity, power_walls, power_damping, &
    power_external, power_lost, n_powers
  use gimp_particle_stage, only: run_pass
  use gimp_nodal_stage, only: collect_pads, remember_images, book_images, copy_masses, sum_slots
  implicit none(type, external)
  private
  public :: begin_newmark, displace_stage, correct_stage, newmark_limit

  !> Sums over the nodes of a slot: powers with v_i and b_i, then momentum per time from outside, reactions, cut nodes
  integer, parameter :: at_pull = 2*n_powers, at_reaction = at_pull + 3, at_cut = at_reaction + 4, n_sums = at_cut

contains

  !> Largest stable omega dt of an oscillator
  elemental real(wp) function newmark_limit(gamma) result(limit)
    real(wp), intent(in) :: gamma
    limit = sqrt(2.0_wp/gamma)
  end function newmark_limit

  !> Accelerations at the start; pads hold momenta, masses and forces
  subroutine begin_newmark(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    call accelerate(s, s%time, 0.0_dp, error)
  end subroutine begin_newmark

  !> Nodes get the velocity of the step, u, and the predictor is booked. `s%walls` have the velocities of mid-step.
  subroutine displace_stage(s)
    type(stepper_t), intent(inout) :: s
    real(dp) :: start
    real(wp) :: u(3), dt
    integer :: slot, i
    start = seconds_now()
    call collect_pads(s)
    call fold_images(s%engine%images, s%engine%table%slots, s%raw)
    dt = real(s%dt, wp)
    !$omp parallel do schedule(static) private(i, u) if(s%engine%table%slots > few_blocks)
    do slot = 1, s%engine%table%slots
      do i = 1, nodes_per_block
        u = 0.0_wp
        if (s%raw(4, i, slot) > s%cutoff_mass) u = (s%raw(1:3, i, slot) + 0.5_wp*dt*s%raw(5:7, i, slot))/s%raw(4, i, slot)
        if (s%held(slot) .and. s%raw(4, i, slot) > s%cutoff_mass) call constrain(s%walls, s%engine%grid, node_at_place(s%engine%grid, s%engine%table%slot_at(:, slot), i), u)
        s%engine%g(1:3, i, slot) = u
        s%engine%g(4, i, slot) = merge(s%raw(4, i, slot), 0.0_wp, s%raw(4, i, slot) > s%cutoff_mass)
        s%engine%g(5:8, i, slot) = 0.0_wp
      end do
    end do
    !$omp end parallel do
    call copy_images(s%engine%images, s%engine%table%slots, s%engine%g)
    s%books%work_forces = 0.0_dp
    s%books%work_gravity = 0.0_dp
    s%books%work_walls = 0.0_dp
    s%books%work_damping = 0.0_dp
    s%books%work_pushed = 0.0_dp
    s%books%given = 0.0_dp
    s%books%grid_before = 0.0_dp
    call book_kick(s, (1.0_dp - s%method%newmark_gamma)*s%dt, 1.0_dp)
    s%seconds(phase_grid) = s%seconds(phase_grid) + seconds_now() - start
  end subroutine displace_stage

  !> After the particles have moved and given their forces: new accelerations and the corrector
  subroutine correct_stage(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    call accelerate(s, s%time + s%dt, s%method%newmark_gamma*s%dt, error)
  end subroutine correct_stage

  !> Accelerations of nodes and particles from the pads, the kick that goes with them, pads for the next step, and their powers
  subroutine accelerate(s, time, kick, error)
    type(stepper_t), intent(inout) :: s
    real(dp), intent(in) :: time, kick !! of the forces [s]; step of velocities [s]
    type(error_t), allocatable, intent(out) :: error
    type(walls_t) :: before, after
    real(wp) :: gravity(3)
    real(dp) :: start, sums(n_sums)
    real(dp), allocatable :: part(:, :) ! (n_sums, slot)
    real(dp) :: turned(3)
    integer :: lost
    turned = 0.0_dp
    start = seconds_now()
    gravity = real(gravity_at(s%loads, time), wp)
    before = s%walls
    after = s%walls
    call move_walls(before, time - s%dt)
    call move_walls(after, time)
    call collect_pads(s)
    call remember_images(s, stage_full)
    call fold_images(s%engine%images, s%engine%table%slots, s%raw)
    call collect_loads(s%loads, s%engine, time)
    if (has_loads(s%loads)) then
      lost = 0
      call copy_masses(s)
      call add_loads(s%loads, s%engine, s%engine%table%slots, s%engine%g, s%cutoff_mass, s%raw, lost, turned)
      s%books%lost_loads = s%books%lost_loads + lost
    end if
    allocate (part(n_sums, s%engine%table%slots), source=0.0_dp)
    call find_accelerations(s, gravity, before, after, part)
    call sum_slots(s, part, sums)
    s%pull = sums(at_pull + 1:at_pull + 3) + turned
    s%books%reaction = sums(at_reaction + 1:at_reaction + 3) + turned
    s%books%cut_nodes = s%books%cut_nodes + nint(sums(at_cut), kind(s%books%cut_nodes))
    call keep_forces(s)
    s%seconds(phase_grid) = s%seconds(phase_grid) + seconds_now() - start
    call run_pass(s, pass_t(acceleration=.true., own_kick=.true., kick=real(kick, wp), momentum=.true., inertia=.true., &
                            old_weights=.true.), error)
    if (allocated(error)) return
    start = seconds_now()
    call collect_pads(s)
    call fold_images(s%engine%images, s%engine%table%slots, s%raw)
    call find_powers(s, gravity, before, after, part)
    call sum_slots(s, part, sums)
    s%power = reshape(sums(:2*n_powers), [2, n_powers])
    call find_outside(s)
    call book_kick(s, kick, -1.0_dp)
    s%seconds(phase_grid) = s%seconds(phase_grid) + seconds_now() - start
  end subroutine accelerate

  !> a = F/m in fields 1-3 and 5-7 of the nodes, sides obeyed; F in fields 5-7 of `s%raw`, without what local damping takes, which
  !> is in fields 1-3
  subroutine find_accelerations(s, gravity, before, after, part)
    type(stepper_t), intent(inout) :: s
    real(wp), intent(in) :: gravity(3)
    type(walls_t), intent(in) :: before, after !! sides at the start and at the end of the step
    real(dp), intent(inout) :: part(:, :)
    real(wp) :: m, a(3), free(3), damped(3), damping
    integer :: slot, i, d
    damping = 0.0_wp
    if (s%method%damping == damping_local) damping = s%method%damping_factor
    d = s%engine%grid%dim
    !$omp parallel do schedule(static) private(i, m, a, free, damped) if(s%engine%table%slots > few_blocks)
    do slot = 1, s%engine%table%slots
      do i = 1, nodes_per_block
        m = s%raw(4, i, slot)
        s%engine%g(:, i, slot) = 0.0_wp
        if (.not. m > s%cutoff_mass) then
          if (m > s%round_off_mass) part(at_cut, slot) = part(at_cut, slot) + 1.0_dp
          part(at_pull + 1:at_pull + 3, slot) = part(at_pull + 1:at_pull + 3, slot) - s%raw(5:7, i, slot)
          s%raw(:, i, slot) = 0.0_wp
          cycle
        end if
        damped = damping*abs(s%raw(5:7, i, slot) + m*gravity)*sign_or_zero(s%raw(1:3, i, slot))
        free = (s%raw(5:7, i, slot) - damped)/m + gravity
        a = free
        if (s%held(slot)) call hold(s, before, after, node_at_place(s%engine%grid, s%engine%table%slot_at(:, slot), i), a)
        s%raw(1:3, i, slot) = damped
        s%engine%g(1:3, i, slot) = a
        s%engine%g(4, i, slot) = m
        s%engine%g(5:7, i, slot) = a
        part(at_reaction + 1:at_reaction + d, slot) = part(at_reaction + 1:at_reaction + d, slot) + m*(a(:d) - free(:d))
        part(at_pull + 1:at_pull + d, slot) = part(at_pull + 1:at_pull + d, slot) + m*(a(:d) - free(:d) + gravity(:d)) - damped(:d)
      end do
    end do
    !$omp end parallel do
    call copy_images(s%engine%images, s%engine%table%slots, s%engine%g)
  end subroutine find_accelerations

  !> What a side holds of an acceleration is the rate at which its velocity changes
  pure subroutine hold(s, before, after, node, a)
    type(stepper_t), intent(in) :: s
    type(walls_t), intent(in) :: before, after
    integer, intent(in) :: node(3)
    real(wp), intent(inout) :: a(3)
    real(wp) :: low(3), high(3)
    low = 0.0_wp
    high = 0.0_wp
    call constrain(before, s%engine%grid, node, a)
    call constrain(before, s%engine%grid, node, low)
    call constrain(after, s%engine%grid, node, high)
    a = a - low
    if (s%dt > 0.0_dp) a = a + (high - low)/real(s%dt, wp)
  end subroutine hold

  !> The forces go to `s%memory`: `s%raw` is wanted for the next pads
  subroutine keep_forces(s)
    type(stepper_t), intent(inout) :: s
    real(wp), allocatable :: spare(:, :, :)
    call move_alloc(s%memory, spare)
    call move_alloc(s%raw, s%memory)
    call move_alloc(spare, s%raw)
  end subroutine keep_forces

  !> Powers of forces, gravity, sides and damping with v_i and b_i; these go to fields 1-3 and 5-7 of the nodes
  subroutine find_powers(s, gravity, before, after, part)
    type(stepper_t), intent(inout) :: s
    real(wp), intent(in) :: gravity(3)
    type(walls_t), intent(in) :: before, after
    real(dp), intent(inout) :: part(:, :)
    real(wp) :: m, raw(3, 2), with(3, 2), side(3)
    integer :: slot, i, k
    !$omp parallel do schedule(static) private(i, k, m, raw, with, side) if(s%engine%table%slots > few_blocks)
    do slot = 1, s%engine%table%slots
      do i = 1, nodes_per_block
        m = s%memory(4, i, slot)
        if (.not. m > 0.0_wp) cycle
        raw(:, 1) = s%raw(1:3, i, slot)/m
        raw(:, 2) = s%raw(5:7, i, slot)/m
        with = raw
        side = 0.0_wp
        if (s%held(slot)) then
          side = m*(s%engine%g(1:3, i, slot) - gravity) - s%memory(5:7, i, slot) + s%memory(1:3, i, slot)
          call constrain(after, s%engine%grid, node_at_place(s%engine%grid, s%engine%table%slot_at(:, slot), i), with(:, 1))
          call hold(s, before, after, node_at_place(s%engine%grid, s%engine%table%slot_at(:, slot), i), with(:, 2))
        end if
        do k = 1, 2
          part(2*power_forces - 2 + k, slot) = part(2*power_forces - 2 + k, slot) + sum(s%memory(5:7, i, slot)*with(:, k))
          part(2*power_gravity - 2 + k, slot) = part(2*power_gravity - 2 + k, slot) + m*sum(gravity*with(:, k))
          part(2*power_walls - 2 + k, slot) = part(2*power_walls - 2 + k, slot) + sum(side*with(:, k))
          part(2*power_lost - 2 + k, slot) = part(2*power_lost - 2 + k, slot) + m*sum(s%engine%g(1:3, i, slot)*(raw(:, k) - with(:, k)))
          part(2*power_damping - 2 + k, slot) = part(2*power_damping - 2 + k, slot) - sum(s%memory(1:3, i, slot)*with(:, k))
        end do
        s%memory(1:3, i, slot) = with(:, 1)
        s%memory(5:7, i, slot) = with(:, 2)
      end do
    end do
    !$omp end parallel do

  end subroutine find_powers

  !> What comes from outside: loads, forces on particles, and what mirrors turn around
  subroutine find_outside(s)
    type(stepper_t), intent(inout) :: s
    real(dp) :: impulse(3), with_velocity
    if (has_images(s%engine%grid)) then
      impulse = s%books%impulse
      call book_images(s, 1.0_dp) ! nodes still have accelerations in fields 5-7: this is a force
      s%pull = s%pull + (s%books%impulse - impulse)
      s%books%impulse = impulse
    end if
    s%power(1, power_external) = s%sums(sum_external)
    s%pull = s%pull + s%sums(sum_impulse:sum_impulse + 2)
    if (.not. has_loads(s%loads)) return
    s%pull = s%pull + sum_of_loads(s%loads)
    with_velocity = work_of_loads(s%loads, s%engine, s%engine%table%slots, s%memory, 1.0_dp, 0.0_wp)
    s%power(1, power_external) = s%power(1, power_external) + with_velocity
    s%power(2, power_external) = work_of_loads(s%loads, s%engine, s%engine%table%slots, s%memory, 1.0_dp, -1.0_wp) - with_velocity
  end subroutine find_outside

  !> Works and impulse of a kick of all particles: `way` is 1 if it is still to come, -1 if v_i has it already
  subroutine book_kick(s, kick, way)
    type(stepper_t), intent(inout) :: s
    real(dp), intent(in) :: kick, way
    real(dp) :: work(n_powers)
    work = kick*s%power(1, :) + 0.5_dp*way*kick**2*s%power(2, :)
    s%books%work_forces = s%books%work_forces + work(power_forces)
    s%books%work_gravity = s%books%work_gravity + work(power_gravity)
    s%books%work_walls = s%books%work_walls + work(power_walls)
    s%books%work_damping = s%books%work_damping + work(power_damping)
    s%books%work_external = s%books%work_external + work(power_external)
    s%books%given = s%books%given - work(power_lost)
    s%books%impulse = s%books%impulse + kick*s%pull
  end subroutine book_kick

end module gimp_newmark
