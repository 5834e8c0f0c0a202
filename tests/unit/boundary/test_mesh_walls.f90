!> What named sides of a mesh do to the velocities of their nodes: as the box where sides lie along axes, else along and across the
!> normals of straight, inclined and curved sides, and both at corners
program test_mesh_walls
  use gimp_kinds, only: wp, dp
  use gimp_common_kinds, only: pi
  use gimp_error, only: error_t
  use gimp_text, only: text_of
  use gimp_grid, only: grid_t, make_grid, nodes_per_block
  use gimp_mesh, only: mesh_t
  use gimp_mesh_connect, only: connect_mesh
  use gimp_made_meshes, only: made_lines, made_quads, made_triangles, made_hybrid, made_tetrahedra, made_hexahedra, made_quadratic, &
    turn_mesh, random_t, random_number_of
  use gimp_walls, only: walls_t, wall_t, side_free, side_stick, side_slip, side_symmetry, side_velocity, side_periodic, constrain, &
    constrain_change, walls_near, move_walls
  use gimp_mesh_walls, only: set_mesh_walls
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  integer, parameter :: conditions(5) = [side_free, side_stick, side_slip, side_symmetry, side_velocity]
  type(random_t) :: random
  type(grid_t) :: mesh_grid

  call begin_suite("walls of a mesh")
  mesh_grid%is_mesh = .true.
  call test_as_box(made_lines(3), "lines", 25)
  call test_as_box(made_quads([3, 2]), "quads", 200)
  call test_as_box(made_triangles([3, 2]), "triangles", 100)
  call test_as_box(made_hybrid([3, 3]), "a hybrid mesh", 100)
  call test_as_box(made_quadratic(made_hybrid([2, 2]), .false.), "triangles and quads with middle nodes", 100)
  call test_as_box(made_quadratic(made_quads([2, 3]), .true.), "quads of nine nodes", 100)
  call test_as_box(made_tetrahedra([2, 2, 2]), "tetrahedra", 100)
  call test_as_box(made_hexahedra([2, 2, 2], 0.2_dp), "hexahedra", 200)
  call test_inclined()
  call test_ring(.false.)
  call test_ring(.true.)
  call test_angles()
  call test_rim()
  call test_planes()
  call test_slots()
  call end_suite()

contains

  !> Rules of a mesh that must not be refused
  subroutine make_walls(mesh, condition, walls)
    type(mesh_t), intent(in) :: mesh
    type(wall_t), intent(in) :: condition(:)
    type(walls_t), intent(out) :: walls
    type(error_t), allocatable :: error
    call set_mesh_walls(walls, mesh, condition, error)
    call check_true(.not. allocated(error), "conditions are taken")
  end subroutine make_walls

  !> The velocity that is left at a node
  function left(walls, node, v) result(w)
    type(walls_t), intent(in) :: walls
    integer, intent(in) :: node
    real(wp), intent(in) :: v(3)
    real(wp) :: w(3)
    w = v
    call constrain(walls, mesh_grid, [node, 0, 0], w)
  end function left

  function some_velocity() result(v)
    real(wp) :: v(3)
    integer :: k
    do k = 1, 3
      v(k) = 2*random_number_of(random) - 1
    end do
  end function some_velocity

  !> A mesh of a box with sides x_low, x_high, .. gives the bits of the box, whatever stands on the sides
  subroutine test_as_box(made, what, rounds)
    type(mesh_t), intent(in) :: made
    character(len=*), intent(in) :: what
    integer, intent(in) :: rounds !! draws of conditions
    type(mesh_t) :: mesh
    type(grid_t) :: grid
    type(walls_t) :: walls, box
    type(wall_t) :: condition(2*made%dim)
    real(wp) :: v(3), u(3), w(3)
    integer :: round, k, i, node(3), differ, held
    mesh = made
    call connect_mesh(mesh)
    grid = make_grid(mesh%dim, spread(0.0_dp, 1, mesh%dim), real(maxval(mesh%x, 2), dp), 0.5_dp) ! middles of sides are nodes of it
    differ = 0
    held = 0
    do round = 1, rounds
      do k = 1, size(condition)
        condition(k)%condition = conditions(1 + int(5*random_number_of(random)))
        condition(k)%velocity = some_velocity()
        box%side(1 + modulo(k - 1, 2), 1 + (k - 1)/2) = condition(k)
      end do
      call make_walls(mesh, condition, walls)
      call move_walls(walls, 0.0_dp)
      call move_walls(box, 0.0_dp)
      do i = 1, mesh%nodes
        v = some_velocity()
        u = v
        w = v
        node = 0
        node(:mesh%dim) = floor(2*mesh%x(:, i)) ! inner nodes may be moved: they stay inside
        call constrain(box, grid, node, u)
        call constrain(walls, mesh_grid, [i, 0, 0], w)
        if (any(transfer(u, [0]) /= transfer(w, [0]))) differ = differ + 1
        if (any(abs(w - v) > 0.0_wp)) held = held + 1
        u = v
        w = v
        call constrain_change(box, grid, node, u)
        call constrain_change(walls, mesh_grid, [i, 0, 0], w)
        if (any(transfer(u, [0]) /= transfer(w, [0]))) differ = differ + 1
      end do
    end do
    call check(differ, 0, what//" on a box: same bits as its sides")
    call check_true(held > rounds, what//": nodes are held")
  end subroutine test_as_box

  !> A turned box: along a side nothing is held, across it all, in corners all, in the plane exactly
  subroutine test_inclined()
    type(mesh_t) :: mesh
    type(walls_t) :: walls
    type(wall_t) :: condition(6)
    real(wp) :: n(3), t(3)
    integer :: i
    condition%condition = side_slip
    mesh = made_hybrid([4, 4])
    call turn_mesh(mesh, 37.0_dp)
    call connect_mesh(mesh)
    call make_walls(mesh, condition(:4), walls)
    n = [cos(37*pi/180), sin(37*pi/180), 0.0_dp]
    t = [-n(2), n(1), 0.0_wp]
    i = 3*5 + 1 ! on x_low
    call check(left(walls, i, n), [0.0_wp, 0.0_wp, 0.0_wp], 4*epsilon(1.0_wp), "an inclined side holds its normal")
    call check(left(walls, i, t), t, 4*epsilon(1.0_wp), "and lets go along it")
    call check(left(walls, 3*5 + 2, n), n, 0.0_wp, "inner nodes are free")
    call check(left(walls, 1, [0.3_wp, -0.7_wp, 0.0_wp]), [0.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "a corner of the plane is held exactly")
    mesh = made_tetrahedra([2, 2, 2])
    call turn_mesh(mesh, 37.0_dp)
    call connect_mesh(mesh)
    condition(5:)%condition = side_free
    call make_walls(mesh, condition, walls)
    call check(left(walls, 10, n + t), [0.0_wp, 0.0_wp, 0.0_wp], 4*epsilon(1.0_wp), "an upright edge holds both normals")
    call check(left(walls, 10, [0.0_wp, 0.0_wp, 2.0_wp]), [0.0_wp, 0.0_wp, 2.0_wp], 0.0_wp, "and lets go along itself")
  end subroutine test_inclined

  !> A quarter of a ring, its ends planes of symmetry: x is the radius from 2 to 4, y the angle in six steps
  subroutine test_ring(quadratic)
    logical, intent(in) :: quadratic
    type(mesh_t) :: mesh
    type(walls_t) :: walls
    type(wall_t) :: condition(4)
    real(wp) :: angle, n(3), off
    integer :: i
    mesh = made_quads([2, 6])
    if (quadratic) mesh = made_quadratic(mesh, .false.)
    condition%condition = [side_slip, side_slip, side_symmetry, side_symmetry]
    do i = 1, mesh%nodes
      angle = mesh%x(2, i)*real(pi, wp)/12
      mesh%x(:, i) = (2 + mesh%x(1, i))*[cos(angle), sin(angle)]
    end do
    call connect_mesh(mesh)
    call make_walls(mesh, condition, walls)
    off = 0.0_wp
    do i = 1, mesh%nodes
      n = [mesh%x(1, i), mesh%x(2, i), 0.0_wp]/norm2(mesh%x(:, i))
      if (abs(mesh%x(2, i)) < 1.0e-9_wp .or. abs(mesh%x(1, i)) < 1.0e-9_wp) then
        n = [n(2), n(1), 0.0_wp]
        call check(left(walls, i, n), [0.0_wp, 0.0_wp, 0.0_wp], 1.0e-15_wp, "a plane of symmetry holds its normal")
        if (abs(norm2(mesh%x(:, i)) - 3.0_wp) < 0.9_wp) cycle ! elsewhere the arcs hold the rest
        call check(left(walls, i, [1.0_wp, 2.0_wp, 0.0_wp]), [0.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "an arc and a plane: a corner")
      else if (abs(norm2(mesh%x(:, i)) - 3.0_wp) < 0.9_wp) then
        call check(left(walls, i, n), n, 0.0_wp, "inside all is free")
      else
        off = max(off, norm2(left(walls, i, n)))
        call check(norm2(left(walls, i, [n(2), -n(1), 0.0_wp])), 1.0_wp, 1.0e-12_wp, "a ring lets go along itself")
      end if
    end do
    call check(off, 0.0_wp, 1.0e-13_wp, "vertex normals of a ring of equal sides are radial")
  end subroutine test_ring

  !> Two quads above a floor that turns by some degrees: smooth or a corner, within a group and between two
  subroutine test_angles()
    real(wp), parameter :: along(3) = [1.0_wp, 0.0_wp, 0.0_wp], nothing(3) = 0.0_wp
    call check(floor_velocity(30.001_dp, .true., side_slip), along, 1.0e-12_wp, "one group with a turn of 30 degrees is smooth, in few digits too")
    call check(floor_velocity(32.0_dp, .true., side_slip), nothing, 0.0_wp, "with one of 32 degrees it has a corner")
    call check(floor_velocity(8.0_dp, .false., side_slip), along, 1.0e-12_wp, "two groups join at a turn of 8 degrees")
    call check(floor_velocity(12.0_dp, .false., side_slip), nothing, 0.0_wp, "and have a corner at one of 12")
    call check(floor_velocity(32.0_dp, .false., side_free), [cos(16*pi/180)**2, sin(16*pi/180)*cos(16*pi/180), 0.0_dp], &
               1.0e-12_wp, "beside a free side the normal is that of the side that is held")
    call check(floor_velocity(8.0_dp, .false., side_stick), nothing, 0.0_wp, "stick beside slip holds all")
  end subroutine test_angles

  !> What is left of a velocity along x at the middle of a floor that falls and rises again by half of `turn` degrees
  function floor_velocity(turn, one_group, other) result(v)
    real(dp), intent(in) :: turn
    logical, intent(in) :: one_group
    integer, intent(in) :: other !! condition of the left part
    real(wp) :: v(3)
    type(mesh_t) :: mesh
    type(walls_t) :: walls
    type(wall_t) :: condition(4)
    integer :: i, side
    mesh = made_quads([2, 1])
    do i = 1, mesh%nodes
      mesh%x(2, i) = mesh%x(2, i) + real(tan(0.5_dp*turn*pi/180), wp)*abs(mesh%x(1, i) - 1)
    end do
    call connect_mesh(mesh)
    condition(3)%condition = side_slip
    condition(2)%condition = other ! x_high hands its number on to the left part of the floor
    where (mesh%side_group == 2) mesh%side_group = 0
    do side = 1, size(mesh%side_group)
      if (mesh%side_group(side) == 3 .and. mesh%side_element(side) == 1 .and. .not. one_group) mesh%side_group(side) = 2
    end do
    call make_walls(mesh, condition, walls)
    v = left(walls, 2, [1.0_wp, 0.0_wp, 0.0_wp])
  end function floor_velocity

  !> The outer side and the top of a bent block as one group: at the rim a velocity is left along the rim alone
  subroutine test_rim()
    type(mesh_t) :: mesh
    type(walls_t) :: walls
    type(wall_t) :: condition(6)
    real(wp) :: angle, along(3), v(3)
    integer :: i, nodes
    mesh = made_hexahedra([2, 4, 2])
    do i = 1, mesh%nodes
      angle = mesh%x(2, i)*15*real(pi, wp)/180
      mesh%x(:2, i) = (2 + mesh%x(1, i))*[cos(angle), sin(angle)]
    end do
    call connect_mesh(mesh)
    where (mesh%side_group == 6) mesh%side_group = 2
    condition(2)%condition = side_slip
    call make_walls(mesh, condition, walls)
    nodes = 0
    do i = 1, mesh%nodes
      if (norm2(mesh%x(:2, i)) < 3.9_wp .or. mesh%x(3, i) < 1.9_wp) cycle
      angle = atan2(mesh%x(2, i), mesh%x(1, i))
      if (angle < 0.1_wp .or. angle > 0.9_wp) cycle ! there the arcs end
      nodes = nodes + 1
      along = [-sin(angle), cos(angle), 0.0_wp]
      v = some_velocity()
      call check(left(walls, i, v), dot_product(v, along)*along, 1.0e-13_wp, "a rim lets go along itself")
    end do
    call check(nodes, 3, "nodes of the rim")
  end subroutine test_rim

  !> A plane of symmetry must be one; nothing can be periodic
  subroutine test_planes()
    type(mesh_t) :: mesh
    type(walls_t) :: walls
    type(wall_t) :: condition(4)
    type(error_t), allocatable :: error
    mesh = made_hybrid([3, 3])
    call turn_mesh(mesh, 11.0_dp)
    mesh%x(2, :) = mesh%x(2, :)*(1 + 0.1_wp*mesh%x(1, :)) ! lines along y stay straight
    call connect_mesh(mesh)
    condition(4)%condition = side_symmetry
    call set_mesh_walls(walls, mesh, condition, error)
    call check_true(allocated(error), "a bent side is no plane of symmetry")
    if (allocated(error)) then
      call check_true(index(error%message, "side group 'y_high'") > 0 .and. index(error%message, " element ") > 0 &
                      .and. index(error%message, "slip") > 0, "the message names group and elements and what to do")
    end if
    condition(4)%condition = side_periodic
    call set_mesh_walls(walls, mesh, condition, error)
    call check_true(allocated(error), "meshes have no periodic sides")
  end subroutine test_planes

  !> Slots know whether one of their nodes is held; places beyond the last node hold nothing
  subroutine test_slots()
    type(mesh_t) :: mesh
    type(walls_t) :: walls
    type(wall_t) :: condition(4)
    integer :: k, i
    mesh = made_quads([9, 19])
    call connect_mesh(mesh)
    call check_true(.not. walls_near(walls, mesh_grid, [1, 0, 0]), "without rules nothing is held")
    call check(left(walls, 1, [1.0_wp, 2.0_wp, 3.0_wp]), [1.0_wp, 2.0_wp, 3.0_wp], 0.0_wp, "without rules nothing is held")
    condition(4)%condition = side_stick ! the last ten nodes of 200
    call make_walls(mesh, condition, walls)
    do k = 0, (mesh%nodes - 1)/nodes_per_block
      call check_true(walls_near(walls, mesh_grid, [k, 0, 0]) .eqv. &
                      any([(any(left(walls, i, [1.0_wp, 1.0_wp, 1.0_wp]) < 1.0_wp), i=64*k + 1, 64*k + 64)]), "a slot knows: "//text_of(k))
    end do
    call check(left(walls, mesh%nodes + 1, [1.0_wp, 2.0_wp, 3.0_wp]), [1.0_wp, 2.0_wp, 3.0_wp], 0.0_wp, "no node, no rule")
  end subroutine test_slots

end program test_mesh_walls
