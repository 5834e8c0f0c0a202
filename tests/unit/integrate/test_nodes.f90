!> The equation of motion of one slot of nodes: kick, cut-off, damping, sides, and the books of each
program test_nodes
  use gimp_kinds, only: wp, dp
  use gimp_grid, only: grid_t, make_grid, nodes_per_block, nf => fields_per_node
  use gimp_walls, only: walls_t, side_slip, side_stick, side_velocity
  use gimp_nodes, only: update_nodes, node_step_t, stage_full, stage_velocity, stage_kick, stage_project, n_node_sums, &
    book_before, book_after, book_given, book_forces, book_gravity, book_walls, book_damping, book_cut, book_cut_momentum, &
    book_reaction, book_impulse, book_held
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  integer, parameter :: n = nodes_per_block
  real(wp), parameter :: round_off = epsilon(1.0_wp), kick = 0.25_wp
  type(grid_t) :: grid

  call begin_suite("nodes")
  grid = make_grid(2, [0.0_wp, 0.0_wp], [40.0_wp, 40.0_wp], 1.0_wp)
  call test_kick()
  call test_two_stages()
  call test_cutoff()
  call test_damping()
  call test_sides()
  call test_project()
  call end_suite()

contains

  !> Reproducible sums as particles might give them
  subroutine some_sums(raw)
    real(wp), intent(out) :: raw(nf, n)
    integer :: i, f
    do i = 1, n
      do f = 1, nf
        raw(f, i) = sin(12.9898_wp*f + 78.233_wp*i)
      end do
      raw(4, i) = 1.5_wp + raw(4, i)
      raw(8, i) = 2.0_wp + raw(8, i)
      raw(3, i) = 0.0_wp
      raw(7, i) = 0.0_wp
    end do
  end subroutine some_sums

  !> v = p/m, v+ = v + dt (f/m + g); forces and gravity work with the mean velocity: what the nodes gain, exactly
  subroutine test_kick()
    type(walls_t) :: walls
    real(wp) :: raw(nf, n), g(nf, n), v(3, n), w(3, n), gravity(3)
    real(dp) :: sums(n_node_sums)
    integer :: i
    gravity = [0.5_wp, -2.0_wp, 0.0_wp]
    call some_sums(raw)
    call update_nodes(node_step_t(stage=stage_full, kick=kick, gravity=gravity, cutoff=1.0e-3_wp), &
                      grid, walls, .false., [1, 1, 0], &
                      raw, g, sums)
    do i = 1, n
      v(:, i) = raw(1:3, i)/raw(4, i)
      w(:, i) = v(:, i) + kick*(raw(5:7, i)/raw(4, i) + gravity)
    end do
    call check(maxval(abs(g(1:3, :) - w)), 0.0_wp, 100*round_off, "velocity after the kick")
    call check(maxval(abs(g(5:7, :) - (w - v))), 0.0_wp, 100*round_off, "its change")
    call check(maxval(abs(g(4, :) - raw(4, :))), 0.0_wp, 0.0_wp, "mass")
    call check(sums(book_given), sum(raw(8, :)), 1.0e-12_wp, "energy that particles gave")
    call check(sums(book_before), 0.5_wp*sum(raw(4, :)*sum(v**2, 1)), 1.0e-11_wp, "kinetic energy before")
    call check(sums(book_after) - sums(book_before), sums(book_forces) + sums(book_gravity), 1.0e-11_wp, &
               "works are what the nodes gain")
    call check(sums(book_gravity), kick*sum(raw(4, :)*(0.5_wp*matmul(gravity, v + w))), 1.0e-11_wp, "work of gravity")
    call check(real(sums(book_impulse:book_impulse + 2), wp), kick*gravity*sum(raw(4, :)), 1.0e-11_wp, "impulse of gravity")
  end subroutine test_kick

  !> USF takes the two halves of the step one after the other: the same velocities and books
  subroutine test_two_stages()
    type(walls_t) :: walls
    real(wp) :: raw(nf, n), forces(nf, n), g(nf, n), both(nf, n)
    real(dp) :: first(n_node_sums), second(n_node_sums), all(n_node_sums)
    call some_sums(raw)
    forces = 0.0_wp
    forces(5:7, :) = raw(5:7, :)
    walls%side(1, 2)%condition = side_slip
    call update_nodes(node_step_t(stage=stage_velocity, kick=kick), grid, walls, .true., [1, 0, 0], raw, g, first)
    call update_nodes(node_step_t(stage=stage_kick, kick=kick), grid, walls, .true., [1, 0, 0], forces, g, second)
    call update_nodes(node_step_t(stage=stage_full, kick=kick), grid, walls, .true., [1, 0, 0], raw, both, all)
    call check(maxval(abs(g - both)), 0.0_wp, 4*round_off, "two stages are one")
    call check(maxval(abs(first + second - all)), 0.0_dp, 1.0e-13_dp, "and so are their books")
  end subroutine test_two_stages

  !> Nodes with too little mass take no part and give nothing; the momentum that particles miss by it (all of the kick, and
  !> the share of PIC of what was there) is counted and taken from the impulse. So is force on a node without any mass; an empty
  !> node that was given nothing is none
  subroutine test_cutoff()
    type(walls_t) :: walls
    real(wp) :: raw(nf, n), g(nf, n), mass
    real(dp) :: sums(n_node_sums)
    call some_sums(raw)
    raw(4, 3) = 1.0e-13_wp
    raw(1:3, 3) = [3.0e-13_wp, -4.0e-13_wp, 0.0_wp]
    raw(5:7, 3) = 0.0_wp
    raw(:, 4) = 0.0_wp
    raw(5:7, 4) = 7.0_wp ! a load on an empty node
    call update_nodes(node_step_t(stage=stage_full, kick=kick, gravity=[0.0_wp, -1.0_wp, 0.0_wp], cutoff=1.0e-12_wp, &
                      pic=0.5_wp), grid, walls, .false., [1, 1, 0], raw, g, sums)
    call check(maxval(abs(g(:, 3:4))), 0.0_wp, 0.0_wp, "light and empty nodes stay at rest, without mass")
    call check(real(sums(book_cut), wp), 2.0_wp, 0.0_wp, "a light node was cut, and an empty one that was given force")
    call check(real(sums(book_cut_momentum), wp), 2.5e-13_wp + kick*7.0_wp*sqrt(3.0_wp), 16*epsilon(1.0_wp), "with their momentum")
    mass = sum(raw(4, :)) - raw(4, 3)
    call check(real(sums(book_impulse:book_impulse + 2), wp), kick*[-7.0_wp, -mass - 7.0_wp, -7.0_wp], 1.0e-11_wp, &
               "the load on an empty node is not in the impulse")
    call check(sums(book_after) - sums(book_before), sums(book_forces) + sums(book_gravity), 1.0e-11_wp, &
               "forces on cut nodes do no work")
  end subroutine test_cutoff

  !> Local damping takes the share alpha of the total force against the velocity: f - alpha |f| sign(v), none at rest
  subroutine test_damping()
    real(wp), parameter :: alpha = 0.7_wp
    type(walls_t) :: walls
    real(wp) :: raw(nf, n), g(nf, n), v(2), f(2), gravity(3), expected(2)
    real(dp) :: sums(n_node_sums)
    integer :: i, wrong
    gravity = [0.0_wp, -0.3_wp, 0.0_wp]
    call some_sums(raw)
    raw(1:2, 5) = 0.0_wp ! a node at rest
    call update_nodes(node_step_t(stage=stage_full, kick=kick, gravity=gravity, damping=alpha), grid, walls, .false., [1, 1, 0], &
                      raw, g, sums)
    wrong = 0
    do i = 1, n
      v = raw(1:2, i)/raw(4, i)
      f = raw(5:6, i) + raw(4, i)*gravity(:2)
      expected = v + kick/raw(4, i)*(f - alpha*abs(f)*sign(1.0_wp, v))
      if (i == 5) expected = kick*f/raw(4, i)
      if (any(abs(g(1:2, i) - expected) > 100*round_off)) wrong = wrong + 1
    end do
    call check(wrong, 0, "damped velocities")
    call check(sums(book_after) - sums(book_before), sums(book_forces) + sums(book_gravity) + sums(book_damping), 1.0e-11_wp, &
               "the books know what damping took")
    raw(1:2, :) = 10.0_wp*spread(raw(4, :), 1, 2)*sign(1.0_wp, raw(1:2, :)) ! so fast that no kick turns a velocity
    call update_nodes(node_step_t(stage=stage_full, kick=kick, gravity=gravity, damping=alpha), grid, walls, .false., [1, 1, 0], &
                      raw, g, sums)
    call check_true(sums(book_damping) < 0.0_dp, "damping takes energy out")
  end subroutine test_damping

  !> Sides: held nodes obey before and after the kick, their reaction is the impulse that was needed, driven sides do work
  subroutine test_sides()
    type(walls_t) :: walls
    real(wp) :: raw(nf, n), g(nf, n), impulse(3), change(3)
    real(dp) :: sums(n_node_sums)
    integer :: i, j, wrong
    walls%side(1, 1)%condition = side_velocity
    walls%side(1, 1)%now = [2.0_wp, 1.0_wp, 0.0_wp]
    walls%side(1, 2)%condition = side_stick
    call some_sums(raw)
    call update_nodes(node_step_t(stage=stage_full, kick=kick), grid, walls, .true., [0, 0, 0], raw, g, sums)
    wrong = 0
    do i = 1, n
      j = (i - 1)/8 ! row of nodes
      if (j == 0 .and. modulo(i - 1, 8) > 0 .and. any(g(1:3, i) /= 0.0_wp)) wrong = wrong + 1
      if (j > 0 .and. modulo(i - 1, 8) == 0 .and. any(g(1:3, i) /= walls%side(1, 1)%now)) wrong = wrong + 1
      if ((j == 0 .or. modulo(i - 1, 8) == 0) .and. any(g(5:7, i) /= 0.0_wp)) wrong = wrong + 1
    end do
    call check(wrong, 0, "held nodes have the velocity of their side, before and after the kick")
    call check(sums(book_after) - sums(book_before), sums(book_forces) + sums(book_gravity) + sums(book_walls), 1.0e-11_wp, &
               "sides are in the books")
    change = 0.0_wp
    impulse = 0.0_wp
    do i = 1, n
      change = change + raw(4, i)*g(1:3, i) - raw(1:3, i)
      impulse = impulse + kick*raw(5:7, i)
    end do
    call check(real(sums(book_reaction:book_reaction + 2) + sums(book_held:book_held + 2), wp), change - impulse, 1.0e-12_wp, &
               "momentum that forces did not give came from the sides")
    call update_nodes(node_step_t(stage=stage_full, kick=kick), grid, walls, .false., [2, 2, 0], raw, g, sums)
    call check(real(maxval(abs(sums(book_reaction:book_reaction + 2))), wp), 0.0_wp, 0.0_wp, "none inside the box")
  end subroutine test_sides

  !> MUSL: new velocities in fields 1-3, those that move particles kept in 5-7; nothing is booked
  subroutine test_project()
    type(walls_t) :: walls
    real(wp) :: raw(nf, n), g(nf, n), old(3, n)
    real(dp) :: sums(n_node_sums)
    call some_sums(raw)
    g = 0.0_wp
    g(1:3, :) = raw(5:7, :)
    old = g(1:3, :)
    call update_nodes(node_step_t(stage=stage_project, kick=kick), grid, walls, .false., [1, 1, 0], &
                      raw, g, sums)
    call check(maxval(abs(g(1:3, :) - raw(1:3, :)/spread(raw(4, :), 1, 3))), 0.0_wp, 4*round_off, "projected velocities")
    call check(maxval(abs(g(5:7, :) - old)), 0.0_wp, 0.0_wp, "velocities that move particles")
    call check(real(maxval(abs(sums)), wp), 0.0_wp, 0.0_wp, "the projection is not booked")
  end subroutine test_project

end program test_nodes
