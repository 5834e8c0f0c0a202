!> Loads on bodies: gravity on all, tractions and pressures on marked faces of particle domains, forces at points.
!>
!> A face gives its force to the nodes by the tents at its corners (algorithms of CPDI and cpGIMP, exact total force), in runs with
!> splines by the splines there; a pressure follows the face, its area vector being J F^-T times the initial one (Nanson). The forces are found from the
!> state at the start of a step and their work from the velocities of the same points in that step.
!>
!> On a mesh, tractions and pressures act on its named sides as well: nodes have int N t dA, found once (the mesh stands still),
!> and those without mass do without: that is counted.
module gimp_loads
  use gimp_kinds, only: wp, sp, dp, i8, lanes
  use gimp_grid, only: nodes_per_block, nf => fields_per_node, node_mass, canonical_node, block_of_node, block_key
  use gimp_blocks, only: block_table_t, slot_of_node, node_in_block
  use gimp_particles, only: few_chunks
  use gimp_mesh, only: mesh_t, kind_nodes
  use gimp_elements, only: natural_coordinates, shape_values, beyond
  use gimp_search, only: find_element, found_t, onto_side
  use gimp_side_shares, only: most_side_nodes, share_side
  use gimp_hash_table, only: find_key
  use gimp_ranks, only: ranks, this_rank
  use gimp_over_ranks, only: sum_of, sum_columns, sum_counts
  use gimp_engine, only: engine_t, spill_t
  use gimp_borders, only: exchange_entries
  use gimp_list_kernel, only: add_spill
  use gimp_splines, only: spline_t, make_spline
  use gimp_basis, only: weight_list_t, make_weight_list, spline_degree
  use gimp_time_table, only: time_table_t, factor_at
  implicit none(type, external)
  private
  public :: load_t, loads_t, load_traction, load_pressure, load_point, gravity_t, gravity_at, side_load_t, set_side_loads
  public :: has_loads, collect_loads, add_loads, work_of_loads, sum_of_loads, most_face_loads

  integer, parameter :: load_traction = 1, load_pressure = 2, load_point = 3
  !> Face loads of a scene: six bits each in a whole number that a particle keeps as a real, 7 in double precision, 4 in single
  integer, parameter :: most_face_loads = merge(4, 7, wp == sp)
  integer, parameter :: most = 64 !! nodes around a point

  !> Gravity, one of possibly several
  type :: gravity_t
    real(dp) :: acceleration(3) = 0.0_dp !! [m/s2]
    type(time_table_t) :: table
  end type gravity_t

  !> A load on particles
  type :: load_t
    integer :: kind = 0
    real(dp) :: vector(3) = 0.0_dp !! traction [Pa] or force [N]
    real(dp) :: pressure = 0.0_dp !! [Pa]
    integer(i8) :: id = 0 !! the particle that a point force acts on
    integer :: place = 0 !! face loads: which six bits of the particles' face number are its own
    type(time_table_t) :: table
  end type load_t

  !> A load on a group of sides of a mesh
  type :: side_load_t
    integer :: group = 0
    real(dp) :: vector(3) = 0.0_dp !! traction [Pa]
    real(dp) :: pressure = 0.0_dp !! pushes into the mesh: -p n, n its outward normal [Pa]
    type(time_table_t) :: table
    ! made by set_side_loads
    integer, allocatable :: node(:) !! of the group, each once
    real(dp), allocatable :: f(:, :) !! (3, node) at factor one [N]
    real(dp) :: now = 0.0_dp !! factor of the present step
  end type side_load_t

  !> All loads, and the points at which they act in the present step
  type :: loads_t
    type(gravity_t), allocatable :: gravity(:)
    type(load_t), allocatable :: load(:)
    type(side_load_t), allocatable :: side(:)
    integer :: n = 0
    real(dp), allocatable :: x(:, :) !! (3, point) [cells from the corner of the box]
    real(dp), allocatable :: f(:, :) !! (3, point) [N]
    integer, allocatable :: block(:), element(:) !! (point) of the particle; elements on a mesh
    ! what loads on sides of a mesh give to its nodes in the present step
    integer :: n_given = 0
    integer, allocatable :: slot(:), place(:) !! nodes of mass that this rank books
    real(dp), allocatable :: given(:, :) !! (3, such a node) [N]
  end type loads_t

contains

  !> Acceleration of gravity at a time [m/s2]
  pure function gravity_at(loads, time) result(g)
    type(loads_t), intent(in) :: loads
    real(dp), intent(in) :: time
    real(dp) :: g(3)
    integer :: k
    g = 0.0_dp
    if (.not. allocated(loads%gravity)) return
    do k = 1, size(loads%gravity)
      g = g + loads%gravity(k)%acceleration*factor_at(loads%gravity(k)%table, time)
    end do
  end function gravity_at

  !> Whether the scene has loads on particles
  pure logical function has_particle_loads(loads) result(has)
    type(loads_t), intent(in) :: loads
    has = .false.
    if (allocated(loads%load)) has = size(loads%load) > 0
  end function has_particle_loads

  !> Whether the scene has loads on sides of the mesh
  pure logical function has_side_loads(loads) result(has)
    type(loads_t), intent(in) :: loads
    has = .false.
    if (allocated(loads%side)) has = size(loads%side) > 0
  end function has_side_loads

  !> Whether the scene has loads on particles or sides
  pure logical function has_loads(loads)
    type(loads_t), intent(in) :: loads
    has_loads = has_particle_loads(loads) .or. has_side_loads(loads)
  end function has_loads

  !> Find the nodal forces of loads on sides, once
  subroutine set_side_loads(loads, mesh, spacing)
    type(loads_t), intent(inout) :: loads
    type(mesh_t), intent(in) :: mesh !! connected
    real(dp), intent(in) :: spacing !! of the grid [m]
    real(dp) :: area(most_side_nodes), outward(3, most_side_nodes), metres
    integer :: l, side, k, n, node(most_side_nodes), number(mesh%nodes)
    if (.not. has_side_loads(loads)) return
    metres = spacing**(mesh%dim - 1)
    do l = 1, size(loads%side)
      associate (load => loads%side(l))
        number = 0
        do side = 1, size(mesh%side_group)
          if (mesh%side_group(side) /= load%group) cycle
          call share_side(mesh, side, n, node, area, outward)
          number(node(:n)) = 1
        end do
        load%node = pack([(k, k=1, mesh%nodes)], number > 0)
        number(load%node) = [(k, k=1, size(load%node))]
        load%f = spread([0.0_dp, 0.0_dp, 0.0_dp], 2, size(load%node))
        do side = 1, size(mesh%side_group)
          if (mesh%side_group(side) /= load%group) cycle
          call share_side(mesh, side, n, node, area, outward)
          do k = 1, n
            load%f(:, number(node(k))) = load%f(:, number(node(k))) + metres*(area(k)*load%vector - load%pressure*outward(:, k))
          end do
        end do
      end associate
    end do
  end subroutine set_side_loads

  !> Points and forces of all loads on particles of this rank at the present positions, in stored order, and factors of those on sides
  subroutine collect_loads(loads, engine, time)
    type(loads_t), intent(inout) :: loads
    type(engine_t), intent(in) :: engine
    real(dp), intent(in) :: time !! [s]
    logical, allocatable :: loaded(:)
    integer :: g, c, l, k
    integer(i8) :: marks
    loads%n = 0
    if (has_side_loads(loads)) then
      do k = 1, size(loads%side)
        loads%side(k)%now = factor_at(loads%side(k)%table, time)
      end do
    end if
    if (.not. has_particle_loads(loads)) return
    if (.not. allocated(loads%x)) allocate (loads%x(3, 64), loads%f(3, 64), loads%block(64), loads%element(64))
    call find_loaded(loads, engine, loaded)
    associate (particles => engine%particles)
      do g = 1, size(particles%groups)
        if (.not. loaded(g)) cycle
        do c = particles%groups(g)%first, particles%groups(g)%last
          do l = 1, lanes
            if (particles%id(l, c) == 0) cycle
            marks = 0
            if (particles%faces%first > 0) marks = int(particles%p(l, particles%faces%first, c), i8)
            do k = 1, size(loads%load)
              if (loads%load(k)%kind == load_point) then
                if (loads%load(k)%id /= particles%id(l, c)) cycle
                call add_point(loads, engine%particles%groups(g)%block, element_of(engine, c, l), place_of(engine, g, c, l), &
                               loads%load(k)%vector*factor_at(loads%load(k)%table, time))
              else if (marks > 0) then
                call add_faces(loads, engine, g, c, l, loads%load(k), iand(shiftr(marks, 6*loads%load(k)%place), 63_i8), time)
              end if
            end do
          end do
        end do
      end do
    end associate
  end subroutine collect_loads

  !> Which groups hold loaded particles: few do, so that the rest of the work is small
  subroutine find_loaded(loads, engine, loaded)
    type(loads_t), intent(in) :: loads
    type(engine_t), intent(in) :: engine
    logical, allocatable, intent(out) :: loaded(:) !! (group)
    integer :: g, c, k
    allocate (loaded(size(engine%particles%groups)), source=.false.)
    associate (particles => engine%particles)
      !$omp parallel do schedule(static) private(c, k) if(particles%chunks > few_chunks)
      do g = 1, size(particles%groups)
        do c = particles%groups(g)%first, particles%groups(g)%last
          if (particles%faces%first > 0) loaded(g) = loaded(g) .or. any(particles%p(:, particles%faces%first, c) > 0.0_wp)
          do k = 1, size(loads%load)
            if (loads%load(k)%kind == load_point) loaded(g) = loaded(g) .or. any(particles%id(:, c) == loads%load(k)%id)
          end do
          if (loaded(g)) exit
        end do
      end do
      !$omp end parallel do
    end associate
  end subroutine find_loaded

  !> Position of a particle in cells from the corner of the box
  pure function place_of(engine, g, c, l) result(x)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: g, c, l
    real(dp) :: x(3)
    integer :: k
    x = 0.0_dp
    do k = 1, engine%grid%dim
      x(k) = real(engine%particles%p(l, k, c), dp) + engine%particles%groups(g)%at(k)*engine%grid%edge(k)
    end do
  end function place_of

  !> Element of a particle, 0 on a grid
  pure integer function element_of(engine, c, l) result(element)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: c, l
    element = 0
    if (engine%particles%element%first > 0) element = abs(nint(engine%particles%p(l, engine%particles%element%first, c)))
  end function element_of

  !> The corners of the loaded faces of one particle
  subroutine add_faces(loads, engine, g, c, l, load, faces, time)
    type(loads_t), intent(inout) :: loads
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: g, c, l
    type(load_t), intent(in) :: load
    integer(i8), intent(in) :: faces !! bits x_low, x_high, y_low, ...
    real(dp), intent(in) :: time
    real(dp) :: x(3), f(3, 3), r(3, 3), s(3, 3), area(3), force(3), side, h
    integer :: bit, k, d, a, b, q, i, j, element
    element = element_of(engine, c, l)
    d = engine%grid%dim
    h = engine%grid%spacing
    f = 0.0_dp
    do i = 1, 3
      f(i, i) = 1.0_dp
    end do
    do i = 1, d
      do j = 1, d
        f(i, j) = engine%particles%p(l, engine%particles%deformation%first + d*(i - 1) + j - 1, c)
      end do
    end do
    r = f ! columns: deformed half edges, in cells
    do k = 1, d
      r(:, k) = f(:, k)*initial_half(engine, c, l, k)
    end do
    s = r ! where the weights see them: at the start, in a total Lagrangian run
    if (engine%total) then
      s = 0.0_dp
      do k = 1, d
        s(k, k) = initial_half(engine, c, l, k)
      end do
    end if
    do bit = 0, 2*d - 1
      if (.not. btest(faces, bit)) cycle
      k = bit/2 + 1
      side = merge(-1.0_dp, 1.0_dp, modulo(bit, 2) == 0)
      x = place_of(engine, g, c, l) + side*s(:, k)
      a = modulo(k, 3) + 1
      b = modulo(k + 1, 3) + 1
      area = side*cross(edge_of(a), edge_of(b)) ! outward area vector of the deformed face [m2]
      if (load%kind == load_pressure) then
        force = -load%pressure*area
      else
        force = load%vector*sqrt(sum(area**2))
      end if
      force = force*factor_at(load%table, time)
      select case (d)
      case (1)
        call add_point(loads, engine%particles%groups(g)%block, element, x, force)
      case (2)
        q = merge(a, b, a <= 2)
        call add_point(loads, engine%particles%groups(g)%block, element, x - s(:, q), 0.5_dp*force)
        call add_point(loads, engine%particles%groups(g)%block, element, x + s(:, q), 0.5_dp*force)
      case default
        call add_point(loads, engine%particles%groups(g)%block, element, x - s(:, a) - s(:, b), 0.25_dp*force)
        call add_point(loads, engine%particles%groups(g)%block, element, x + s(:, a) - s(:, b), 0.25_dp*force)
        call add_point(loads, engine%particles%groups(g)%block, element, x - s(:, a) + s(:, b), 0.25_dp*force)
        call add_point(loads, engine%particles%groups(g)%block, element, x + s(:, a) + s(:, b), 0.25_dp*force)
      end select
    end do

  contains

    !> Full edge of the face along an axis [m]; axes beyond the dimension have unit length
    pure function edge_of(axis) result(edge)
      integer, intent(in) :: axis
      real(dp) :: edge(3)
      edge = f(:, axis)
      if (axis <= d) edge = 2.0_dp*h*r(:, axis)
    end function edge_of

    pure function cross(u, v) result(w)
      real(dp), intent(in) :: u(3), v(3)
      real(dp) :: w(3)
      w = [u(2)*v(3) - u(3)*v(2), u(3)*v(1) - u(1)*v(3), u(1)*v(2) - u(2)*v(1)]
    end function cross

  end subroutine add_faces

  !> Initial half length of a particle [cells]
  pure real(wp) function initial_half(engine, c, l, k) result(half)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: c, l, k
    half = engine%particles%uniform_half(k)
    if (engine%particles%half_length%first > 0) half = engine%particles%p(l, engine%particles%half_length%first + k - 1, c)
  end function initial_half

  subroutine add_point(loads, block, element, x, f)
    type(loads_t), intent(inout) :: loads
    integer, intent(in) :: block, element
    real(dp), intent(in) :: x(3), f(3)
    real(dp), allocatable :: wider(:, :)
    if (loads%n == size(loads%x, 2)) then
      allocate (wider(3, 2*loads%n))
      wider(:, :loads%n) = loads%x
      call move_alloc(wider, loads%x)
      allocate (wider(3, 2*loads%n))
      wider(:, :loads%n) = loads%f
      call move_alloc(wider, loads%f)
      loads%block = [loads%block, loads%block]
      loads%element = [loads%element, loads%element]
    end if
    loads%n = loads%n + 1
    loads%x(:, loads%n) = x
    loads%block(loads%n) = block
    loads%element(loads%n) = element
    loads%f(:, loads%n) = f
  end subroutine add_point

  !> Force of all loads [N]. Collective
  function sum_of_loads(loads) result(force)
    type(loads_t), intent(in) :: loads
    real(dp) :: force(3)
    real(dp) :: f(3, loads%n + loads%n_given)
    if (loads%n > 0) f(:, :loads%n) = loads%f(:, :loads%n)
    if (loads%n_given > 0) f(:, loads%n + 1:) = loads%given(:, :loads%n_given)
    call sum_columns(f, force)
  end function sum_of_loads

  !> Add the loads to the forces of the nodes (fields 5-7), with tents or splines at the points. Collective
  subroutine add_loads(loads, engine, slots, masses, cutoff, raw, lost, turned)
    type(loads_t), intent(inout) :: loads !! notes what sides gave
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: slots
    real(wp), intent(in) :: masses(nf, nodes_per_block, slots) !! field 4: nodal masses, images folded
    real(wp), intent(in) :: cutoff !! nodes with less mass do not move [kg]
    real(wp), intent(inout) :: raw(nf, nodes_per_block, slots)
    real(dp), intent(out) :: turned(3) !! what planes of symmetry add to the forces, as they turn around what goes to their images [N]
    integer, intent(inout) :: lost !! points without a node of mass around them and nodes of loaded sides without mass: their force is lost
    type(spill_t) :: given
    real(wp) :: s(most), sign(3, most), value(nf)
    real(dp) :: part(3, loads%n)
    integer :: q, k, n, slot(most), place(most)
    integer(i8) :: nowhere
    value = 0.0_wp
    nowhere = 0
    if (has_side_loads(loads)) call add_side_loads(loads, engine, slots, masses, cutoff, raw, nowhere)
    part = 0.0_dp
    do q = 1, loads%n
      call find_nodes(loads, q, engine, slots, masses, cutoff, n, slot, place, s, sign)
      if (n == 0) nowhere = nowhere + 1
      do k = 1, n
        value(5:7) = real(s(k)*sign(:, k)*loads%f(:, q), wp)
        part(:, q) = part(:, q) + s(k)*(sign(:, k) - 1.0_wp)*loads%f(:, q)
        if (ranks > 1) then ! nodes may be of several ranks: they all add in the order of blocks
          call add_spill(given, loads%block(q), slot(k), place(k), value)
        else
          raw(5:7, place(k), slot(k)) = raw(5:7, place(k), slot(k)) + value(5:7)
        end if
      end do
    end do
    lost = lost + int(sum_counts(nowhere))
    turned = 0.0_dp
    if (any(engine%grid%mirror_low) .or. any(engine%grid%mirror_high)) call sum_columns(part, turned)
    if (ranks == 1 .or. .not. has_particle_loads(loads)) return
    call exchange_entries(engine, given)
    do k = 1, given%n
      raw(5:7, given%place(k), given%slot(k)) = raw(5:7, given%place(k), given%slot(k)) + given%value(5:7, k)
    end do
  end subroutine add_loads

  !> Add the loads on sides to all nodes of mass that this rank has: their sums are complete here
  subroutine add_side_loads(loads, engine, slots, masses, cutoff, raw, nowhere)
    type(loads_t), intent(inout) :: loads
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: slots
    real(wp), intent(in) :: masses(nf, nodes_per_block, slots), cutoff
    real(wp), intent(inout) :: raw(nf, nodes_per_block, slots)
    integer(i8), intent(out) :: nowhere !! summed over ranks: loaded nodes without mass
    real(dp) :: force(3)
    integer :: l, i, slot, place, n
    n = sum([(size(loads%side(l)%node), l=1, size(loads%side))])
    if (.not. allocated(loads%given)) allocate (loads%given(3, n), loads%slot(n), loads%place(n))
    n = 0
    nowhere = 0
    do l = 1, size(loads%side)
      associate (load => loads%side(l))
        if (abs(load%now) <= 0.0_dp) cycle
        if (this_rank == 0) nowhere = nowhere + size(load%node) ! from which each rank takes those that it books
        do i = 1, size(load%node)
          call find_place(engine%table, load%node(i), slot, place)
          if (slot == 0) cycle
          if (.not. masses(node_mass, place, slot) > cutoff) cycle
          force = load%now*load%f(:, i)
          raw(5:7, place, slot) = raw(5:7, place, slot) + real(force, wp)
          if (.not. engine%table%booked(slot)) cycle
          n = n + 1
          loads%given(:, n) = force
          loads%slot(n) = slot
          loads%place(n) = place
        end do
      end associate
    end do
    nowhere = nowhere - n
    loads%n_given = n
  end subroutine add_side_loads

  !> The nodes of mass around a point and their shares: tents (splines, shape functions of a mesh), or where some of the nodes have no mass
  !> (the corner of a sheared domain may reach beyond the material) those of the others, scaled so that no force is lost. Nodes farther
  !> than the neighbours of the particle's block do not count.
  subroutine find_nodes(loads, q, engine, slots, masses, cutoff, n, slot, place, s, sign)
    type(loads_t), intent(in) :: loads
    integer, intent(in) :: q !! the point
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: slots
    real(wp), intent(in) :: masses(nf, nodes_per_block, slots), cutoff
    integer, intent(out) :: n, slot(most), place(most)
    real(wp), intent(out) :: s(most), sign(3, most)
    real(wp), parameter :: least_on_mesh = 0.1_wp ! shape functions may be negative: nothing is scaled up beyond its tenfold
    real(wp) :: total
    integer :: i, around
    logical :: complete, on_mesh
    on_mesh = engine%grid%is_mesh
    if (on_mesh) then
      call nodes_of_mesh(engine, loads%block(q), loads%element(q), loads%x(:, q), around, slot, place, s, sign)
    else
      call nodes_of_grid(engine, loads%block(q), loads%x(:, q), around, slot, place, s, sign)
    end if
    n = 0
    total = 0.0_wp
    complete = .true.
    do i = 1, around
      if (slot(i) > 0) then
        if (masses(node_mass, place(i), slot(i)) > cutoff) then
          n = n + 1
          slot(n) = slot(i)
          place(n) = place(i)
          s(n) = s(i)
          sign(:, n) = sign(:, i)
          total = total + s(n)
          cycle
        end if
      end if
      complete = complete .and. s(i) <= 0.0_wp .and. (s(i) >= 0.0_wp .or. .not. on_mesh)
    end do
    if (complete) return
    if (total > merge(least_on_mesh, 0.0_wp, on_mesh)) then
      s(:n) = s(:n)/total
    else if (n > 0) then
      s(:n) = 1.0_wp/n ! the point lies right on a node without mass
    end if
  end subroutine find_nodes

  !> The nodes of the grid around a point: weights, and slots or 0
  subroutine nodes_of_grid(engine, near, x, n, slot, place, s, sign)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: near !! block of the particle
    real(dp), intent(in) :: x(3)
    integer, intent(out) :: n, slot(most), place(most)
    real(wp), intent(out) :: s(most), sign(3, most)
    type(weight_list_t) :: list
    type(spline_t) :: spline
    real(wp) :: at(3)
    integer :: i, home(3), origin(3), target(3), block(3), last(3), last_slot
    last = huge(1) ! neighbours in the list mostly share a block: one search for all of them
    last_slot = 0
    home = block_of_node(engine%grid, floor(x)) ! weights are found in the coordinates of a block, as those of particles
    origin = home*engine%grid%edge
    spline = make_spline(spline_degree(engine%basis), engine%grid, home)
    at = real(x - origin, wp)
    if (spline%open) at = min(max(at, spline%low), spline%high) ! the corner of a domain may lie outside the box
    call make_weight_list(engine%grid%dim, at, [0.0_wp, 0.0_wp, 0.0_wp], spline, list)
    n = list%n
    do i = 1, n
      call canonical_node(engine%grid, list%node(:, i) + origin, target, sign(:, i))
      block = block_of_node(engine%grid, target)
      if (any(block /= last)) last_slot = slot_of_node(engine%table, engine%grid, target)
      last = block
      slot(i) = last_slot
      if (any(abs(block_of_node(engine%grid, list%node(:, i) + origin) - engine%table%block_at(:, near)) > 1)) slot(i) = 0
      place(i) = node_in_block(engine%grid, target)
      s(i) = list%s(i)
    end do
  end subroutine nodes_of_grid

  !> The nodes of the element around a point, looked for from that of its particle. Outside of the mesh the shape functions of the element
  !> at the side that was crossed go on for a while; points farther off are put onto the side.
  subroutine nodes_of_mesh(engine, near, start, x, n, slot, place, s, sign)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: near, start !! block and element of the particle
    real(dp), intent(in) :: x(3)
    integer, intent(out) :: n, slot(most), place(most)
    real(wp), intent(out) :: s(most), sign(3, most)
    real(wp) :: at(engine%grid%dim), xi(engine%grid%dim), unknown(engine%grid%dim)
    type(found_t) :: found
    integer :: i, kind
    logical :: ok
    at = real(x(:engine%grid%dim), wp)
    unknown = 0.0_wp
    sign = 1.0_wp
    n = 0
    call find_element(engine%mesh, engine%locator, engine%search_rule, at, unknown, start, found)
    if (found%element == 0) return
    kind = engine%mesh%kind(found%element)
    associate (nodes => engine%mesh%node(:kind_nodes(kind), found%element))
      call natural_coordinates(kind, engine%mesh%x(:, nodes), at, xi, ok)
      if (found%side > 0 .and. .not. (ok .and. beyond(kind, xi) <= 1.0_wp)) then
        call onto_side(engine%mesh, found%side, at)
        call natural_coordinates(kind, engine%mesh%x(:, nodes), at, xi, ok)
      end if
      if (.not. ok) return
      n = size(nodes)
      call shape_values(kind, xi, s(:n))
      do i = 1, n
        call find_place(engine%table, nodes(i), slot(i), place(i))
        if (.not. any(engine%table%slot_near(:, near) == slot(i))) slot(i) = 0
      end do
    end associate
  end subroutine nodes_of_mesh

  !> Slot of a node of the mesh, 0 if it is not active, and its place there
  pure subroutine find_place(table, node, slot, place)
    type(block_table_t), intent(in) :: table
    integer, intent(in) :: node
    integer, intent(out) :: slot, place
    slot = find_key(table%slot_of, block_key([(node - 1)/nodes_per_block, 0, 0]))
    place = 1 + modulo(node - 1, nodes_per_block)
  end subroutine find_place

  !> Work of the loads in the step with the velocity of fields 1-3 minus a share of fields 5-7 (half: the mean before and after
  !> the force); call before particles move. Collective
  real(dp) function work_of_loads(loads, engine, slots, g, kick, back) result(work)
    type(loads_t), intent(in) :: loads
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: slots
    real(wp), intent(in) :: g(nf, nodes_per_block, slots)
    real(dp), intent(in) :: kick !! step of velocities [s]
    real(wp), intent(in) :: back !! that share
    real(wp) :: s(most), sign(3, most)
    real(dp) :: part(loads%n + loads%n_given)
    integer :: q, k, n, slot(most), place(most)
    part = 0.0_dp
    do q = 1, loads%n_given
      associate (node => g(:, loads%place(q), loads%slot(q)))
        part(loads%n + q) = kick*sum(loads%given(:, q)*(node(1:3) - back*node(5:7)))
      end associate
    end do
    do q = 1, loads%n
      call find_nodes(loads, q, engine, slots, g, 0.0_wp, n, slot, place, s, sign)
      do k = 1, n
        part(q) = part(q) + kick*s(k)*sum(sign(:, k)*loads%f(:, q)*(g(1:3, place(k), slot(k)) &
                                                              - back*g(5:7, place(k), slot(k))))
      end do
    end do
    work = sum_of(part)
  end function work_of_loads

end module gimp_loads
