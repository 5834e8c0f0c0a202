!> The equation of motion on the nodes of one slot, with conditions, damping and books.
!>
!> Fields of the grid: before the update 1-3 momentum, 4 mass, 5-7 force, 8 kinetic energy given by the particles; after it
!> 1-3 velocity, 4 mass, 5-7 change of velocity (or, after the projection of MUSL, the velocity that moves particles). Where light nodes hand on force
!> (gimp_light_nodes), 8 says between the velocity and the kick how much of it.
module gimp_nodes
  use gimp_kinds, only: wp, dp, lanes
  use gimp_grid, only: grid_t, node_at_place, nodes_per_block, nf => fields_per_node
  use gimp_walls, only: walls_t, constrain
  use gimp_light_nodes, only: light_field
  use gimp_kernels, only: to_lanes, to_fields
  implicit none(type, external)
  private
  public :: update_nodes, fields_last, fields_first, velocity_of, note_cut_nodes, sign_or_zero
  public :: node_step_t, stage_full, stage_velocity, stage_kick, stage_project
  public :: n_node_sums, book_before, book_after, book_given, book_forces, book_gravity, book_walls, book_damping, book_cut, &
    book_cut_momentum, book_reaction, book_pushed, book_impulse, book_held

  integer, parameter :: stage_full = 1 !! velocity from momentum, then the kick by the forces
  integer, parameter :: stage_velocity = 2 !! velocity from momentum only
  integer, parameter :: stage_kick = 3 !! the kick, on velocities that are there already
  integer, parameter :: stage_project = 4 !! MUSL: velocity from the new particle velocities

  integer, parameter :: book_before = 1, book_after = 2, book_given = 3, book_forces = 4, book_gravity = 5, book_walls = 6, &
    book_damping = 7, book_cut = 8, book_cut_momentum = 9, book_reaction = 10 !! 10-12: impulse of the sides after the kick
  integer, parameter :: book_pushed = 13 !! work of moving sides on the velocity before the kick
  integer, parameter :: book_impulse = 14 !! 14-16: impulse of gravity and damping
  integer, parameter :: book_held = 17 !! 17-19: impulse of the sides on the velocity before the kick
  integer, parameter :: n_node_sums = 19

  !> What the update of this step needs to know
  type :: node_step_t
    integer :: stage = stage_full
    real(wp) :: kick = 0.0_wp !! step of velocities [s]
    real(wp) :: gravity(3) = 0.0_wp !! [m/s2]
    real(wp) :: cutoff = 0.0_wp !! nodes with less mass are left out [kg]
    real(wp) :: round_off = 0.0_wp !! masses up to here are round-off [kg]
    real(wp) :: light = 0.0_wp !! nodes with less mass hand on force [kg]
    real(wp) :: pic = 0.0_wp !! share of PIC in the transfer
    real(wp) :: damping = 0.0_wp !! share of the force taken out by local damping (Cundall)
  end type node_step_t

contains

  !> Update the nodes of one slot
  subroutine update_nodes(step, grid, walls, held, at, raw, g, sums)
    type(node_step_t), intent(in) :: step
    type(grid_t), intent(in) :: grid
    type(walls_t), intent(in) :: walls
    logical, intent(in) :: held !! some node of the slot is on a side or beyond
    integer, intent(in) :: at(3) !! block coordinates
    real(wp), intent(in) :: raw(nf, nodes_per_block) !! what the particles gave
    real(wp), intent(inout) :: g(nf, nodes_per_block) !! what the particles will take
    real(dp), intent(out) :: sums(n_node_sums) !! books of this slot
    integer, parameter :: n = nodes_per_block
    real(wp) :: q(n, nf), m(n), v(n, 3), w(n, 3), old(n, nf)
    integer :: i, k
    sums = 0.0_dp
    call fields_last(raw, q)

    if (step%stage == stage_kick) then
      call fields_last(g, old)
      v = old(:, 1:3)
      m = old(:, 4)
      call note_lost_forces(n, step%kick, m, q, sums)
    else
      call velocity_of(n, step%cutoff, q, m, v)
      if (step%stage /= stage_project) call note_cut_nodes(n, step, m, q, sums)
      if (held) call hold(v, book=step%stage /= stage_project)
    end if
    if (step%stage == stage_velocity .or. step%stage == stage_full) sums(book_given) = sum(real(q(:, 8), dp))

    select case (step%stage)
    case (stage_project)
      call fields_last(g, old)
      q(:, 1:3) = v
      q(:, 5:7) = old(:, 1:3)
    case (stage_velocity)
      q(:, 1:3) = v
      q(:, 5:7) = 0.0_wp
    case default
      call kick_nodes(n, step, m, v, q(:, 5:7), w, sums)
      if (held) call hold_after_kick()
      call book_energy(n, grid%dim, m, v, w, sums)
      do k = 1, 3
        !$omp simd
        do i = 1, n
          q(i, k) = w(i, k)
          q(i, 4 + k) = w(i, k) - v(i, k)
        end do
      end do
    end select
    q(:, 4) = m
    q(:, 8) = 0.0_wp
    if (step%stage == stage_velocity .and. step%light > 0.0_wp) q(:, light_field) = max(0.0_wp, 1.0_wp - m/step%light)
    call fields_first(q, g)

  contains

    !> Conditions on a velocity before the kick. Particles feel it only through the PIC share of the transfer
    subroutine hold(u, book)
      real(wp), intent(inout) :: u(n, 3)
      logical, intent(in) :: book
      real(wp) :: free(3)
      integer :: j
      do j = 1, n
        if (m(j) <= 0.0_wp) cycle
        free = u(j, :)
        call constrain(walls, grid, node_at_place(grid, at, j), u(j, :))
        if (.not. book) cycle
        sums(book_held:book_held + 2) = sums(book_held:book_held + 2) + real(m(j)*(u(j, :) - free), dp)
        sums(book_pushed) = sums(book_pushed) + real(m(j)*sum((u(j, :) - free)*u(j, :)), dp)
      end do
    end subroutine hold

    !> Conditions after the kick; the sides do work on the material with the mean velocity
    subroutine hold_after_kick()
      real(wp) :: free(3), impulse(3)
      integer :: j
      do j = 1, n
        if (m(j) <= 0.0_wp) cycle
        free = w(j, :)
        call constrain(walls, grid, node_at_place(grid, at, j), w(j, :))
        impulse = m(j)*(w(j, :) - free)
        sums(book_reaction:book_reaction + 2) = sums(book_reaction:book_reaction + 2) + real(impulse, dp)
        sums(book_walls) = sums(book_walls) + real(0.5_wp*sum(impulse*(v(j, :) + w(j, :))), dp)
        ! the forces did their work with the velocity that the sides then allowed
        sums(book_forces) = sums(book_forces) + real(0.5_wp*step%kick*sum(q(j, 5:7)*(w(j, :) - free)), dp)
        sums(book_gravity) = sums(book_gravity) + real(0.5_wp*step%kick*m(j)*sum(step%gravity*(w(j, :) - free)), dp)
        if (step%damping > 0.0_wp) sums(book_damping) = sums(book_damping) &
          - real(0.5_wp*step%kick*step%damping*sum(abs(q(j, 5:7) + m(j)*step%gravity)*sign_or_zero(v(j, :))*(w(j, :) - free)), dp)
      end do
    end subroutine hold_after_kick

  end subroutine update_nodes

  !> Nodes in lanes, so that what follows is vectors of nodes
  pure subroutine fields_last(g, q)
    real(wp), intent(in) :: g(nf, nodes_per_block)
    real(wp), intent(out) :: q(nodes_per_block, nf)
    real(wp) :: turned(lanes, nf)
    integer :: i
    do i = 1, nodes_per_block, lanes
      call to_lanes(g(:, i:i + lanes - 1), turned)
      q(i:i + lanes - 1, :) = turned
    end do
  end subroutine fields_last

  !> And back
  pure subroutine fields_first(q, g)
    real(wp), intent(in) :: q(nodes_per_block, nf)
    real(wp), intent(out) :: g(nf, nodes_per_block)
    real(wp) :: turned(lanes, nf)
    integer :: i
    do i = 1, nodes_per_block, lanes
      turned = q(i:i + lanes - 1, :)
      call to_fields(turned, g(:, i:i + lanes - 1))
    end do
  end subroutine fields_first

  !> Velocity and mass of nodes; those with too little mass have none
  pure subroutine velocity_of(n, cutoff, q, m, v)
    integer, intent(in) :: n
    real(wp), intent(in) :: cutoff, q(n, nf) !! momentum and mass in fields 1-4
    real(wp), intent(out) :: m(n), v(n, 3)
    real(wp) :: r
    integer :: i
    !$omp simd private(r)
    do i = 1, n
      r = 0.0_wp
      m(i) = 0.0_wp
      if (q(i, 4) > cutoff) then
        r = 1.0_wp/q(i, 4)
        m(i) = q(i, 4)
      end if
      v(i, 1) = q(i, 1)*r
      v(i, 2) = q(i, 2)*r
      v(i, 3) = q(i, 3)*r
    end do
  end subroutine velocity_of

  !> The force of a cut node is lost
  pure subroutine note_lost_forces(n, kick, m, q, sums)
    integer, intent(in) :: n
    real(wp), intent(in) :: kick, m(n), q(n, nf)
    real(dp), intent(inout) :: sums(n_node_sums)
    integer :: i
    do i = 1, n
      if (m(i) > 0.0_wp) cycle
      sums(book_impulse:book_impulse + 2) = sums(book_impulse:book_impulse + 2) - real(kick*q(i, 5:7), dp)
    end do
  end subroutine note_lost_forces

  !> w = v + kick (f/m + gravity), with local damping -alpha |f| sign(v) (Cundall); works with the unconstrained mean velocity
  subroutine kick_nodes(n, step, m, v, force, w, sums)
    integer, intent(in) :: n
    type(node_step_t), intent(in) :: step
    real(wp), intent(in) :: m(n), v(n, 3), force(n, 3)
    real(wp), intent(out) :: w(n, 3)
    real(dp), intent(inout) :: sums(n_node_sums)
    real(wp) :: f, total, damped, r(n), kick, mean, gravity, damping
    real(dp) :: work_f, work_g, work_d, pushed
    integer :: i, k
    kick = step%kick
    damping = step%damping
    !$omp simd
    do i = 1, n
      r(i) = 0.0_wp
      if (m(i) > 0.0_wp) r(i) = 1.0_wp/m(i)
    end do
    do k = 1, 3
      work_f = 0.0_dp
      work_g = 0.0_dp
      work_d = 0.0_dp
      pushed = 0.0_dp
      gravity = step%gravity(k)
      !$omp simd private(f, total, damped, mean) reduction(+:work_f, work_g, work_d, pushed)
      do i = 1, n
        f = merge(force(i, k), 0.0_wp, m(i) > 0.0_wp)
        total = f + m(i)*gravity
        damped = merge(sign(damping*abs(total), v(i, k)), 0.0_wp, v(i, k) /= 0.0_wp)
        w(i, k) = v(i, k) + kick*(total - damped)*r(i)
        mean = 0.5_wp*(v(i, k) + w(i, k))
        work_f = work_f + real(kick*f*mean, dp)
        work_g = work_g + real(kick*m(i)*gravity*mean, dp)
        work_d = work_d - real(kick*damped*mean, dp)
        pushed = pushed + real(kick*(m(i)*gravity - damped), dp)
      end do
      sums(book_forces) = sums(book_forces) + work_f
      sums(book_gravity) = sums(book_gravity) + work_g
      sums(book_damping) = sums(book_damping) + work_d
      sums(book_impulse + k - 1) = sums(book_impulse + k - 1) + pushed
    end do
  end subroutine kick_nodes

  pure elemental real(wp) function sign_or_zero(x)
    real(wp), intent(in) :: x
    sign_or_zero = 0.0_wp
    if (x /= 0.0_wp) sign_or_zero = sign(1.0_wp, x)
  end function sign_or_zero

  !> Kinetic energy of the nodes before and after the kick
  subroutine book_energy(n, d, m, v, w, sums)
    integer, intent(in) :: n, d
    real(wp), intent(in) :: m(n), v(n, 3), w(n, 3)
    real(dp), intent(inout) :: sums(n_node_sums)
    real(dp) :: before, after
    integer :: i, k
    do k = 1, d
      before = 0.0_dp
      after = 0.0_dp
      !$omp simd reduction(+:before, after)
      do i = 1, n
        before = before + real(0.5_wp*m(i)*v(i, k)**2, dp)
        after = after + real(0.5_wp*m(i)*w(i, k)**2, dp)
      end do
      sums(book_before) = sums(book_before) + before
      sums(book_after) = sums(book_after) + after
    end do
  end subroutine book_energy

  !> Nodes with too little mass drop what they were given: count them, and the momentum that particles will miss.
  !> Masses of round-off size are no masses: weights of a node that a domain just touches. A node without any that was given force
  !> all the same (smeared gradients reach further than the hats) does count.
  pure subroutine note_cut_nodes(n, step, m, q, sums)
    integer, intent(in) :: n
    type(node_step_t), intent(in) :: step
    real(wp), intent(in) :: m(n), q(n, nf)
    real(dp), intent(inout) :: sums(n_node_sums)
    real(wp) :: lost(3)
    integer :: i
    if (all(m > 0.0_wp)) return
    do i = 1, n
      if (m(i) > 0.0_wp) cycle
      lost = step%pic*q(i, 1:3)
      if (step%stage == stage_full) lost = lost + step%kick*q(i, 5:7)
      sums(book_impulse:book_impulse + 2) = sums(book_impulse:book_impulse + 2) - real(lost, dp)
      if (q(i, 4) <= step%round_off .and. .not. (q(i, 4) <= 0.0_wp .and. any(abs(lost) > 0.0_wp))) cycle
      sums(book_cut) = sums(book_cut) + 1.0_dp
      sums(book_cut_momentum) = sums(book_cut_momentum) + real(sqrt(sum(lost**2)), dp)
    end do
  end subroutine note_cut_nodes

end module gimp_nodes
