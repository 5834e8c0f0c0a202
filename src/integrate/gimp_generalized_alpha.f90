!> Explicit generalised-alpha (Hulbert & Chung 1996, CMAME 137:175), in the form in which particles keep the acceleration:
!>
!>   a^n = sum m S a_p / m_i,   (1 - am) a1 + am a^n = f(x^n)/m_i
!>   d = dt v^n + dt^2 [(1/2 - be) a^n + be a1],   w = v^n + dt [(1 - ga) a^n + ga a1]
!>   a_p = S a1,   v_p += S (w - v^n),   x_p += S d,   L = grad(d)/dt
!>
!> all with the weights of x^n. In the first step a^n = f/m. On a side both accelerations are the rate of its velocity.
!>
!> Stability. The oscillator is stable up to Omega = `stability_limit`, and rho_b is its spectral radius at `bifurcation_limit`.
!> On the grid a mode that the way to particles and back shrinks by p (an eigenvalue of P, see gimp_stability) keeps p of its
!> velocity change and acceleration; its amplification has the root -1 at
!>   Omega^2 = 2 [1 - am (1 + p)] / [be (1 + p) - (1 + ga) p/2 + (1 - ga) p^2/2]
!> (checked against the eigenvalues of the 3 x 3 matrix for p from 0 to 1), which grows from p = 0, `mapped_limit`, to p = 1, the
!> oscillator. Modes with light nodes and short waves have small p: the critical step of a scene is found with `mapped_limit`.
!>
!> Books. The kick is that of the forces and the difference that the memory makes,
!>   m (w - v^n) = dt f + dt (1 - ga/(1 - am)) (m a^n - f).
!> Works are those of (v^n + w)/2, which makes the identity of gimp_books exact. The second term is booked with the forces of the
!> particles: together they are the force in the middle of the step, where f alone is that of its start. What the method takes out
!> of short waves shows as `e_stress`, the work of these forces that the material does not know of. Where a side holds a component,
!> there is no second term: the side gives what f leaves to the acceleration of the side.
module gimp_generalized_alpha
  use gimp_kinds, only: wp, dp
  use gimp_error, only: error_t
  use gimp_timer, only: seconds_now
  use gimp_grid, only: grid_t, node_at_place, nodes_per_block, nf => fields_per_node, has_images
  use gimp_blocks, only: few_blocks
  use gimp_images, only: fold_images, copy_images
  use gimp_engine, only: pass_t
  use gimp_walls, only: walls_t, move_walls, constrain, constrain_change
  use gimp_loads, only: gravity_at, has_loads, collect_loads, add_loads, work_of_loads, sum_of_loads
  use gimp_nodes, only: node_step_t, stage_full, fields_last, fields_first, velocity_of, note_cut_nodes, sign_or_zero, n_node_sums, &
    book_before, book_after, book_given, book_forces, book_gravity, book_walls, book_damping, book_reaction, book_impulse
  use gimp_run_state, only: stepper_t, damping_local, phase_grid
  use gimp_particle_stage, only: run_pass
  use gimp_nodal_stage, only: collect_pads, remember_images, book_images, book_stage, copy_masses, sum_slots
  implicit none(type, external)
  private
  public :: alpha_t, make_alpha, advance_free, bifurcation_limit, stability_limit, mapped_limit, alpha_stage

  !> The constants of the method
  type :: alpha_t
    real(wp) :: am = 0.0_wp !! alpha_m
    real(wp) :: be = 0.0_wp !! beta
    real(wp) :: ga = 0.0_wp !! gamma
  end type alpha_t

  !> What the update of this step needs to know
  type :: alpha_step_t
    type(alpha_t) :: c
    type(node_step_t) :: node !! its `kick` is dt
    type(walls_t) :: before, after !! sides with their velocities at t^n and t^{n+1}
    logical :: first = .false. !! no memory yet
  end type alpha_step_t

contains

  !> Constants for a spectral radius at the bifurcation (Hulbert & Chung 1996, eq. 31 ff.)
  elemental type(alpha_t) function make_alpha(radius) result(c)
    real(wp), intent(in) :: radius !! rho_b, 0 to 1
    c%am = (2.0_wp*radius - 1.0_wp)/(1.0_wp + radius)
    c%be = (5.0_wp - 3.0_wp*radius)/((1.0_wp + radius)**2*(2.0_wp - radius))
    c%ga = 1.5_wp - c%am
  end function make_alpha

  !> omega dt at which the two roots that damp short waves meet
  elemental real(wp) function bifurcation_limit(radius) result(limit)
    real(wp), intent(in) :: radius
    limit = (1.0_wp + radius)*sqrt(2.0_wp - radius)
  end function bifurcation_limit

  !> Largest stable omega dt of an oscillator
  elemental real(wp) function stability_limit(radius) result(limit)
    real(wp), intent(in) :: radius
    limit = sqrt(12.0_wp*(1.0_wp + radius)*(2.0_wp - radius)/(10.0_wp - 5.0_wp*radius + radius**2))
  end function stability_limit

  !> Largest stable omega dt of any mode of the grid, whatever the particles keep of it
  elemental real(wp) function mapped_limit(radius) result(limit)
    real(wp), intent(in) :: radius
    type(alpha_t) :: c
    c = make_alpha(radius)
    limit = sqrt(2.0_wp*(1.0_wp - c%am)/c%be)
  end function mapped_limit

  !> New acceleration, mean velocity and new velocity of a degree of freedom from force per mass, old acceleration and velocity
  elemental subroutine advance_free(c, dt, force, a0, v, a1, u, w)
    type(alpha_t), intent(in) :: c
    real(wp), intent(in) :: dt, force, a0, v !! [s], [m/s2], [m/s2], [m/s]
    real(wp), intent(out) :: a1, u, w !! a^{n+1}, d/dt, v^{n+1}
    a1 = (force - c%am*a0)/(1.0_wp - c%am)
    call blend(c, dt, a0, a1, v, u, w)
  end subroutine advance_free

  elemental subroutine blend(c, dt, a0, a1, v, u, w)
    type(alpha_t), intent(in) :: c
    real(wp), intent(in) :: dt, a0, a1, v
    real(wp), intent(out) :: u, w
    u = v + dt*((0.5_wp - c%be)*a0 + c%be*a1)
    w = v + dt*((1.0_wp - c%ga)*a0 + c%ga*a1)
  end subroutine blend

  !> From the pads at the start of a step to nodes that the last pass can take from: d/dt in fields 1-3, w - v^n in fields 5-7.
  !> Particles have their new accelerations then.
  subroutine alpha_stage(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    type(alpha_step_t) :: step
    real(dp) :: start, turned(3)
    start = seconds_now()
    call begin_step(s, step)
    call gather_forces(s, turned)
    s%seconds(phase_grid) = s%seconds(phase_grid) + seconds_now() - start
    if (.not. step%first) call run_pass(s, pass_t(inertia=.true., old_weights=.true.), error)
    if (allocated(error)) return
    start = seconds_now()
    call gather_memory(s) ! in the first step for the array alone
    call update_all(s, step)
    s%books%impulse = s%books%impulse + s%dt*turned
    s%books%reaction = s%books%reaction + turned
    s%seconds(phase_grid) = s%seconds(phase_grid) + seconds_now() - start
    call run_pass(s, pass_t(acceleration=.true.), error)
    if (allocated(error)) return
    start = seconds_now()
    call put_displacements(s)
    if (has_loads(s%loads)) then
      s%books%impulse = s%books%impulse + s%dt*sum_of_loads(s%loads)
      s%books%work_external = s%books%work_external + work_of_loads(s%loads, s%engine, s%engine%table%slots, s%engine%g, s%dt, 0.0_wp)
    end if
    if (has_images(s%engine%grid)) call book_images(s, s%dt)
    s%seconds(phase_grid) = s%seconds(phase_grid) + seconds_now() - start
  end subroutine alpha_stage

  !> Constants of the step in hand
  subroutine begin_step(s, step)
    type(stepper_t), intent(in) :: s
    type(alpha_step_t), intent(out) :: step
    step%c = make_alpha(s%method%spectral_radius)
    step%first = s%step == 0
    step%node = node_step_t(stage=stage_full, kick=real(s%dt, wp), gravity=real(gravity_at(s%loads, s%time), wp), &
                            cutoff=s%cutoff_mass, round_off=s%round_off_mass, pic=0.0_wp)
    if (s%method%damping == damping_local) step%node%damping = s%method%damping_factor
    step%before = s%walls
    step%after = s%walls
    call move_walls(step%before, s%time)
    call move_walls(step%after, s%time + s%dt)
  end subroutine begin_step

  !> Momenta, masses and forces of all nodes into `s%memory`
  subroutine gather_forces(s, turned)
    type(stepper_t), intent(inout) :: s
    real(dp), intent(out) :: turned(3) !! what planes of symmetry add to loads [N]
    real(wp), allocatable :: spare(:, :, :)
    integer :: lost
    turned = 0.0_dp
    call collect_pads(s)
    call remember_images(s, stage_full)
    call fold_images(s%engine%images, s%engine%table%slots, s%raw)
    call collect_loads(s%loads, s%engine, s%time)
    if (has_loads(s%loads)) then
      lost = 0
      call copy_masses(s)
      call add_loads(s%loads, s%engine, s%engine%table%slots, s%engine%g, s%cutoff_mass, s%raw, lost, turned)
      s%books%lost_loads = s%books%lost_loads + lost
    end if
    call move_alloc(s%memory, spare)
    call move_alloc(s%raw, s%memory)
    call move_alloc(spare, s%raw)
  end subroutine gather_forces

  !> Mass times old acceleration of all nodes into fields 5-7 of `s%raw`
  subroutine gather_memory(s)
    type(stepper_t), intent(inout) :: s
    call collect_pads(s)
    call fold_images(s%engine%images, s%engine%table%slots, s%raw)
  end subroutine gather_memory

  !> The nodal equations of all slots; accelerations go to the nodes, d/dt waits in fields 1-3 of `s%memory`
  subroutine update_all(s, step)
    type(stepper_t), intent(inout) :: s
    type(alpha_step_t), intent(in) :: step
    real(dp), allocatable :: part(:, :) ! (n_node_sums, slot)
    real(dp) :: sums(n_node_sums)
    integer :: slot
    associate (engine => s%engine, table => s%engine%table)
      allocate (part(n_node_sums, table%slots))
      !$omp parallel do schedule(dynamic, 16) if(table%slots > few_blocks)
      do slot = 1, table%slots
        call update_slot(step, engine%grid, s%held(slot), table%slot_at(:, slot), s%raw(5:7, :, slot), s%memory(:, :, slot), &
                         engine%g(:, :, slot), part(:, slot))
      end do
      !$omp end parallel do
      call copy_images(engine%images, table%slots, engine%g)
    end associate
    call sum_slots(s, part, sums)
    call book_stage(s%books, stage_full, s%dt, 0.0_dp, sums)
  end subroutine update_all

  !> d/dt takes the place of the acceleration
  subroutine put_displacements(s)
    type(stepper_t), intent(inout) :: s
    integer :: slot
    !$omp parallel do schedule(static) if(s%engine%table%slots > few_blocks)
    do slot = 1, s%engine%table%slots
      s%engine%g(1:3, :, slot) = s%memory(1:3, :, slot)
    end do
    !$omp end parallel do
    call copy_images(s%engine%images, s%engine%table%slots, s%engine%g)
  end subroutine put_displacements

  !> The nodal equations of one slot
  subroutine update_slot(step, grid, held, at, memory, given, g, sums)
    type(alpha_step_t), intent(in) :: step
    type(grid_t), intent(in) :: grid
    logical, intent(in) :: held !! some node of the slot is on a side or beyond
    integer, intent(in) :: at(3) !! block coordinates
    real(wp), intent(in) :: memory(3, nodes_per_block) !! mass times old acceleration
    real(wp), intent(inout) :: given(nf, nodes_per_block) !! what particles gave; on return d/dt in fields 1-3
    real(wp), intent(out) :: g(nf, nodes_per_block) !! new acceleration, mass, change of velocity
    real(dp), intent(out) :: sums(n_node_sums)
    integer, parameter :: n = nodes_per_block
    real(wp), dimension(n, 3) :: v, force, damped, a0, a1, u, w, change, side
    real(wp) :: q(n, nf), m(n), pull
    integer :: i, k
    sums = 0.0_dp
    call fields_last(given, q)
    call velocity_of(n, step%node%cutoff, q, m, v)
    call note_cut_nodes(n, step%node, m, q, sums)
    sums(book_given) = sum(real(q(:, 8), dp))
    if (held) call hold_velocity()
    call forces_of(n, step, m, v, q(:, 5:7), force, damped)
    do k = 1, 3
      do i = 1, n
        a0(i, k) = 0.0_wp
        if (m(i) > 0.0_wp .and. .not. step%first) a0(i, k) = memory(k, i)/m(i)
        if (m(i) > 0.0_wp .and. step%first) a0(i, k) = force(i, k)/m(i)
      end do
    end do
    if (held) call hold_acceleration(a0)
    do k = 1, 3
      do i = 1, n
        pull = 0.0_wp
        if (m(i) > 0.0_wp) pull = force(i, k)/m(i)
        call advance_free(step%c, step%node%kick, pull, a0(i, k), v(i, k), a1(i, k), u(i, k), w(i, k))
      end do
    end do
    if (held) call hold_acceleration(a1)
    if (held) call blend(step%c, step%node%kick, a0, a1, v, u, w)
    do k = 1, 3
      do i = 1, n
        change(i, k) = m(i)*a0(i, k) - force(i, k)
      end do
    end do
    side = 0.0_wp
    if (held) call share_with_sides()
    call book_nodes(n, grid%dim, step, m, v, force, damped, change, side, w, sums)
    q(:, 1:3) = u
    call fields_first(q, given)
    q(:, 1:3) = a1
    q(:, 4) = m
    q(:, 5:7) = w - v
    q(:, 8) = 0.0_wp
    call fields_first(q, g)

  contains

    subroutine hold_velocity()
      real(wp) :: x(3)
      integer :: j
      do j = 1, n
        if (m(j) <= 0.0_wp) cycle
        x = v(j, :)
        call constrain(step%before, grid, node_at_place(grid, at, j), x)
        v(j, :) = x
      end do
    end subroutine hold_velocity

    !> What a side holds of an acceleration is the rate at which its velocity changes
    subroutine hold_acceleration(a)
      real(wp), intent(inout) :: a(n, 3)
      real(wp) :: x(3), low(3), high(3)
      integer :: j
      do j = 1, n
        if (m(j) <= 0.0_wp) cycle
        x = a(j, :)
        low = 0.0_wp
        high = 0.0_wp
        call constrain(step%before, grid, node_at_place(grid, at, j), x)
        call constrain(step%before, grid, node_at_place(grid, at, j), low)
        call constrain(step%after, grid, node_at_place(grid, at, j), high)
        a(j, :) = (x - low) + (high - low)/step%node%kick
      end do
    end subroutine hold_acceleration

    !> Along what a side holds there is no second term, and the side gives what f leaves to the change of velocity
    subroutine share_with_sides()
      real(wp) :: x(3), total(3)
      integer :: j
      do j = 1, n
        if (m(j) <= 0.0_wp) cycle
        x = change(j, :)
        call constrain_change(step%before, grid, node_at_place(grid, at, j), x)
        change(j, :) = x
        total = m(j)*(w(j, :) - v(j, :)) - step%node%kick*force(j, :)
        x = total
        call constrain_change(step%before, grid, node_at_place(grid, at, j), x)
        side(j, :) = total - x
      end do
    end subroutine share_with_sides

  end subroutine update_slot

  !> All forces on the nodes, and what local damping (Cundall) takes of them
  pure subroutine forces_of(n, step, m, v, f, force, damped)
    integer, intent(in) :: n
    type(alpha_step_t), intent(in) :: step
    real(wp), intent(in) :: m(n), v(n, 3), f(n, 3) !! masses, velocities, what particles and loads gave
    real(wp), intent(out) :: force(n, 3), damped(n, 3) !! [N]
    integer :: i, k
    do k = 1, 3
      do i = 1, n
        force(i, k) = merge(f(i, k), 0.0_wp, m(i) > 0.0_wp) + m(i)*step%node%gravity(k)
        damped(i, k) = step%node%damping*abs(force(i, k))*sign_or_zero(v(i, k))
        force(i, k) = force(i, k) - damped(i, k)
      end do
    end do
  end subroutine forces_of

  !> Works and impulses of the step (see the head of this module)
  subroutine book_nodes(n, dim, step, m, v, force, damped, change, side, w, sums)
    integer, intent(in) :: n, dim
    type(alpha_step_t), intent(in) :: step
    real(wp), intent(in) :: m(n)
    real(wp), intent(in), dimension(n, 3) :: v, force, damped, w
    real(wp), intent(in) :: change(n, 3) !! m a^n - f where nothing is held
    real(wp), intent(in) :: side(n, 3) !! impulse of sides
    real(dp), intent(inout) :: sums(n_node_sums)
    real(wp) :: dt, share, mean, pull, filter
    real(dp) :: part(7)
    integer :: i, k
    dt = step%node%kick
    share = dt*(1.0_wp - step%c%ga/(1.0_wp - step%c%am))
    do k = 1, dim
      part = 0.0_dp
      do i = 1, n
        mean = 0.5_wp*(v(i, k) + w(i, k))
        pull = m(i)*step%node%gravity(k)
        filter = share*change(i, k)
        part(1) = part(1) + real(0.5_wp*m(i)*v(i, k)**2, dp)
        part(2) = part(2) + real(0.5_wp*m(i)*w(i, k)**2, dp)
        part(3) = part(3) + real((dt*(force(i, k) - pull + damped(i, k)) + filter)*mean, dp)
        part(4) = part(4) + real(dt*pull*mean, dp)
        part(5) = part(5) - real(dt*damped(i, k)*mean, dp)
        part(6) = part(6) + real(side(i, k)*mean, dp)
        sums(book_reaction + k - 1) = sums(book_reaction + k - 1) + real(side(i, k), dp)
        part(7) = part(7) + real(dt*(pull - damped(i, k)) + filter, dp)
      end do
      sums(book_before) = sums(book_before) + part(1)
      sums(book_after) = sums(book_after) + part(2)
      sums(book_forces) = sums(book_forces) + part(3)
      sums(book_gravity) = sums(book_gravity) + part(4)
      sums(book_damping) = sums(book_damping) + part(5)
      sums(book_walls) = sums(book_walls) + part(6)
      sums(book_impulse + k - 1) = sums(book_impulse + k - 1) + part(7)
    end do
  end subroutine book_nodes

end module gimp_generalized_alpha
