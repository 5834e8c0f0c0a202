!> Loads at points on meshes: a grid as a mesh gives what the grid gives, and on any mesh, also a little outside of it, nodes have the
!> force of the points with its moment
program test_mesh_loads
  use gimp_kinds, only: wp, dp
  use gimp_grid, only: nodes_per_block, nf => fields_per_node, node_mass, node_at_place
  use gimp_basis, only: basis_linear
  use gimp_mesh, only: mesh_t
  use gimp_made_meshes, only: made_lines, made_quads, made_hexahedra, made_triangles, made_hybrid, made_tetrahedra, made_quadratic
  use gimp_engine, only: engine_t
  use gimp_resort, only: sort_particles
  use gimp_loads, only: loads_t, load_pressure, load_traction, collect_loads, add_loads, work_of_loads
  use gimp_engine_fixture, only: cloud_t, lattice_cloud, make_engine
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.5_wp

  call begin_suite("loads on meshes")
  call test_as_grid(1, made_lines(20))
  call test_as_grid(2, made_quads([14, 14]))
  call test_as_grid(3, made_hexahedra([8, 8, 8]))
  call test_moments(2, 14, 5.3_wp, made_quads([14, 14], 0.3_dp), "distorted quads")
  call test_moments(2, 14, 5.3_wp, made_hybrid([14, 14], 0.3_dp), "a hybrid mesh")
  call test_moments(2, 14, 5.3_wp, made_quadratic(made_hybrid([14, 14]), .false.), "elements with middle nodes")
  call test_moments(3, 8, 2.3_wp, made_tetrahedra([8, 8, 8], 0.2_dp), "tetrahedra")
  call test_moments(3, 8, 2.3_wp, made_hexahedra([8, 8, 8], 0.2_dp), "hexahedra")
  call test_moments(2, 14, 0.02_wp, made_triangles([14, 14], 0.3_dp), "triangles at a corner of the mesh")
  call test_moments(3, 8, 0.02_wp, made_hexahedra([8, 8, 8], 0.2_dp), "hexahedra at a corner of the mesh")
  call test_far_outside()
  call end_suite()

contains

  !> A block of 3 cells an axis whose lower corner is at `low`, stretched and turned, with a pressure and a traction all around its particles
  subroutine loaded_block(dim, cells, low, engine, loads, mesh)
    integer, intent(in) :: dim, cells
    real(wp), intent(in) :: low
    type(engine_t), intent(out) :: engine
    type(loads_t), intent(out) :: loads
    type(mesh_t), intent(in), optional :: mesh
    type(cloud_t) :: cloud
    real(wp), parameter :: f(3, 3) = reshape([1.2_wp, 0.3_wp, -0.2_wp, -0.25_wp, 0.9_wp, 0.2_wp, 0.1_wp, -0.15_wp, 1.1_wp], [3, 3])
    integer :: i, k, box(3)
    call lattice_cloud(dim, [0, 0, 0], [3, 3, 3], 2, spacing, 1000.0_wp, cloud)
    do i = 1, cloud%n
      cloud%x(:dim, i) = cloud%x(:dim, i) + low
      cloud%faces(i) = real(2**(2*dim) - 1 + 64*(2**(2*dim) - 1), wp)
      do k = 1, dim
        cloud%f(3*k - 2:3*k - 3 + dim, i) = f(k, :dim)
      end do
    end do
    box = 1
    box(:dim) = cells
    call make_engine(dim, basis_linear, box, spacing, cloud, engine, with_faces=.true., mesh=mesh)
    call sort_particles(engine)
    allocate (loads%load(2))
    loads%load(1)%kind = load_pressure
    loads%load(1)%pressure = 7.0_dp
    loads%load(2)%kind = load_traction
    loads%load(2)%place = 1
    loads%load(2)%vector = merge([2.0_dp, -1.0_dp, 0.5_dp], 0.0_dp, [1, 2, 3] <= dim)
    call collect_loads(loads, engine, 0.0_dp)
  end subroutine loaded_block

  !> Nodes of mass, all of them or those right of `from`, or all but each `gap`-th of a mesh; the velocity is linear in x
  subroutine set_nodes(engine, from, gap)
    type(engine_t), intent(inout) :: engine
    real(wp), intent(in) :: from !! [cells]
    integer, intent(in), optional :: gap
    real(wp), parameter :: l(3, 3) = reshape([0.3_wp, -0.2_wp, 0.1_wp, 0.4_wp, 0.5_wp, -0.6_wp, 0.7_wp, 0.2_wp, -0.9_wp], [3, 3])
    real(wp) :: x(3)
    integer :: slot, place
    engine%g = 0.0_wp
    do slot = 1, engine%table%slots
      do place = 1, nodes_per_block
        x = place_of(engine, slot, place)
        if (x(1) >= from) engine%g(node_mass, place, slot) = 1.0_wp
        if (present(gap)) then
          if (modulo(place + nodes_per_block*engine%table%slot_at(1, slot), gap) == 0) engine%g(node_mass, place, slot) = 0.0_wp
        end if
        engine%g(1:3, place, slot) = matmul(l, x) + [1.0_wp, 2.0_wp, 3.0_wp]
      end do
    end do
  end subroutine set_nodes

  !> Where a node is; places of the last slot without a node are nowhere
  function place_of(engine, slot, place) result(x)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: slot, place
    real(wp) :: x(3)
    integer :: node(3)
    node = node_at_place(engine%grid, engine%table%slot_at(:, slot), place)
    x = node
    if (.not. engine%grid%is_mesh) return
    x = 0.0_wp
    if (node(1) <= engine%mesh%nodes) x(:engine%grid%dim) = engine%mesh%x(:, node(1))
  end function place_of

  !> Sum of the nodal forces, and of the dyads of place and force
  subroutine spread_loads(engine, loads, from, force, moment, work, lost, gap)
    type(engine_t), intent(inout) :: engine
    type(loads_t), intent(inout) :: loads
    real(wp), intent(in) :: from
    real(wp), intent(out) :: force(3), moment(3, 3)
    real(dp), intent(out) :: work
    integer, intent(out) :: lost
    integer, intent(in), optional :: gap
    real(wp), allocatable :: raw(:, :, :)
    real(wp) :: x(3)
    real(dp) :: turned(3)
    integer :: slot, place, k
    allocate (raw(nf, nodes_per_block, engine%table%slots), source=0.0_wp)
    call set_nodes(engine, from, gap)
    lost = 0
    call add_loads(loads, engine, engine%table%slots, engine%g, 0.5_wp, raw, lost, turned)
    work = work_of_loads(loads, engine, engine%table%slots, engine%g, 1.0_dp, 0.0_wp)
    force = 0.0_wp
    moment = 0.0_wp
    do slot = 1, engine%table%slots
      do place = 1, nodes_per_block
        x = place_of(engine, slot, place)
        force = force + raw(5:7, place, slot)
        do k = 1, 3
          moment(:, k) = moment(:, k) + x*raw(4 + k, place, slot)
        end do
      end do
    end do
  end subroutine spread_loads

  !> The same forces and moments on a grid and on a mesh that is one, with all nodes and with some without mass
  subroutine test_as_grid(dim, mesh)
    integer, intent(in) :: dim
    type(mesh_t), intent(in) :: mesh
    type(engine_t) :: on_grid, on_mesh
    type(loads_t) :: grid_loads, mesh_loads
    real(wp) :: f(3, 2), m(3, 3, 2), from
    real(dp) :: work(2)
    integer :: lost(2), round, cells
    character(len=:), allocatable :: what
    cells = nint(maxval(mesh%x))
    call loaded_block(dim, cells, 2.3_wp, on_grid, grid_loads)
    call loaded_block(dim, cells, 2.3_wp, on_mesh, mesh_loads, mesh)
    do round = 1, 3
      from = merge(-99.0_wp, merge(3.0_wp, 99.0_wp, round == 2), round == 1)
      what = text_of(dim)//"D, nodes of mass from "//text_of(nint(from))
      call spread_loads(on_grid, grid_loads, from, f(:, 1), m(:, :, 1), work(1), lost(1))
      call spread_loads(on_mesh, mesh_loads, from, f(:, 2), m(:, :, 2), work(2), lost(2))
      call check(f(:, 2), f(:, 1), 1.0e-12_wp, "force as on the grid, "//what)
      call check(maxval(abs(m(:, :, 2) - m(:, :, 1))), 0.0_wp, 2.0e-11_wp, "moments as on the grid, "//what)
      call check(work(2), work(1), 2.0e-11_dp, "work as on the grid, "//what)
      call check(lost(2), lost(1), "as many points lost as on the grid, "//what)
    end do
    call check(lost(2), mesh_loads%n, "without any mass all are lost")
  end subroutine test_as_grid

  !> Shape functions reproduce linear fields: nodes have force, moment and work of the points, wherever these lie
  subroutine test_moments(dim, cells, low, mesh, what)
    integer, intent(in) :: dim, cells
    real(wp), intent(in) :: low
    type(mesh_t), intent(in) :: mesh
    character(len=*), intent(in) :: what
    type(engine_t) :: engine
    type(loads_t) :: loads
    real(wp) :: force(3), moment(3, 3), expected(3), moments(3, 3), scale
    real(dp) :: work
    integer :: lost, q, k
    call loaded_block(dim, cells, low, engine, loads, mesh)
    call spread_loads(engine, loads, -99.0_wp, force, moment, work, lost)
    expected = 0.0_wp
    moments = 0.0_wp
    do q = 1, loads%n
      expected = expected + loads%f(:, q)
      do k = 1, 3
        moments(:, k) = moments(:, k) + loads%x(:, q)*loads%f(k, q)
      end do
    end do
    scale = sum(abs(loads%f(:, :loads%n)))
    call check(lost, 0, what//": no load is lost")
    call check(force, expected, 1.0e-14_wp*scale, what//": force of the points") ! shape functions add up to one within round-off
    call check(maxval(abs(moment - moments)), 0.0_wp, 1.0e-13_wp*scale, what//": moments of the points")
    if (low < 1.0_wp) call check_true(any(loads%x(:dim, :loads%n) < -0.05_wp), what//": some lie outside")
    call spread_loads(engine, loads, -99.0_wp, force, moment, work, lost, gap=5)
    call check(lost, 0, what//": the nodes of mass take the rest")
    call check(force, expected, 1.0e-14_wp*scale, what//": all of it")
  end subroutine test_moments

  !> A point far outside counts at the side that it is nearest to
  subroutine test_far_outside()
    type(engine_t) :: engine
    type(loads_t) :: loads
    real(wp) :: force(3), moment(3, 3)
    real(dp) :: work
    integer :: lost
    call loaded_block(2, 14, 0.2_wp, engine, loads, made_quads([14, 14]))
    loads%n = 1
    loads%x(:, 1) = [2.25_dp, -9.0_dp, 0.0_dp]
    loads%f(:, 1) = [0.0_dp, 3.0_dp, 0.0_dp]
    call spread_loads(engine, loads, -99.0_wp, force, moment, work, lost)
    call check(force, [0.0_wp, 3.0_wp, 0.0_wp], 1.0e-14_wp, "a point far outside keeps its force")
    call check(moment(:, 2), [6.75_wp, 0.0_wp, 0.0_wp], 1.0e-13_wp, "and has it at the side")
  end subroutine test_far_outside

end program test_mesh_loads
