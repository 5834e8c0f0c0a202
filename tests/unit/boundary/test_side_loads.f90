!> Loads on named sides of a mesh: shares of sides add up, forces, moments and work are exact, what meets no mass is counted
program test_side_loads
  use gimp_kinds, only: wp, dp
  use gimp_text, only: text_of
  use gimp_grid, only: nodes_per_block, nf => fields_per_node, node_mass, block_key
  use gimp_hash_table, only: clear_table, insert_key
  use gimp_mesh, only: mesh_t
  use gimp_mesh_connect, only: connect_mesh
  use gimp_made_meshes, only: made_lines, made_quads, made_triangles, made_hybrid, made_tetrahedra, made_hexahedra, made_quadratic, turn_mesh
  use gimp_side_shares, only: most_side_nodes, share_side
  use gimp_engine, only: engine_t
  use gimp_loads, only: loads_t, has_loads, set_side_loads, collect_loads, add_loads, work_of_loads, sum_of_loads
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: round_off = epsilon(1.0_wp)

  call begin_suite("loads on sides")
  call test_closed(made_lines(4, 0.3_dp), 4.0_wp, "lines")
  call test_closed(made_quads([3, 4], 0.3_dp), 12.0_wp, "quads")
  call test_closed(made_triangles([3, 4], 0.3_dp), 12.0_wp, "triangles")
  call test_closed(made_hybrid([4, 4], 0.3_dp), 16.0_wp, "a hybrid mesh")
  call test_closed(made_quadratic(made_quads([3, 4]), .false.), 12.0_wp, "straight quads of eight nodes")
  call test_closed(made_tetrahedra([2, 3, 2], 0.2_dp), 12.0_wp, "tetrahedra")
  call test_closed(made_hexahedra([2, 3, 2], 0.2_dp), 12.0_wp, "hexahedra")
  call test_bulged()
  call test_edge_shares()
  call test_linear_traction()
  call test_nodes()
  call end_suite()

contains

  !> The mesh stretched and sheared as one, so that no side lies along an axis (lengths of volume `factor` times as large)
  subroutine shear(mesh, factor)
    type(mesh_t), intent(inout) :: mesh
    real(wp), intent(out) :: factor
    real(wp), parameter :: a(3, 3) = reshape([1.2_wp, 0.3_wp, -0.2_wp, -0.1_wp, 0.9_wp, 0.4_wp, 0.25_wp, -0.15_wp, 1.1_wp], [3, 3])
    integer :: d
    d = mesh%dim
    mesh%x = matmul(a(:d, :d), mesh%x)
    select case (d)
    case (1); factor = a(1, 1)
    case (2); factor = a(1, 1)*a(2, 2) - a(1, 2)*a(2, 1)
    case default
      factor = a(1, 1)*(a(2, 2)*a(3, 3) - a(2, 3)*a(3, 2)) - a(1, 2)*(a(2, 1)*a(3, 3) - a(2, 3)*a(3, 1)) &
               + a(1, 3)*(a(2, 1)*a(3, 2) - a(2, 2)*a(3, 1))
    end select
  end subroutine shear

  !> Outward areas of a closed surface add up to nothing, and by Gauss's theorem their products with positions to dim times the volume
  subroutine test_closed(made, volume, what)
    type(mesh_t), intent(in) :: made
    real(wp), intent(in) :: volume
    character(len=*), intent(in) :: what
    type(mesh_t) :: mesh
    real(wp) :: factor
    real(dp) :: total(3), flux
    mesh = made
    call shear(mesh, factor)
    call connect_mesh(mesh)
    call sum_shares(mesh, total, flux)
    call check(maxval(abs(total)), 0.0_dp, 1.0e-13_dp, what//": a closed surface has no net area")
    call check(flux, real(mesh%dim*volume*factor, dp), 1.0e-12_dp, what//": flux of x is dim times the volume")
  end subroutine test_closed

  subroutine sum_shares(mesh, total, flux)
    type(mesh_t), intent(in) :: mesh
    real(dp), intent(out) :: total(3), flux
    real(dp) :: area(most_side_nodes), outward(3, most_side_nodes)
    integer :: side, k, n, node(most_side_nodes)
    total = 0.0_dp
    flux = 0.0_dp
    do side = 1, size(mesh%side_element)
      call share_side(mesh, side, n, node, area, outward)
      do k = 1, n
        total = total + outward(:, k)
        flux = flux + sum(outward(:mesh%dim, k)*mesh%x(:, node(k)))
      end do
    end do
  end subroutine sum_shares

  !> Bulged sides: the volume is that of the corners and 2/3 of height times length of each bulge
  subroutine test_bulged()
    type(mesh_t) :: mesh
    real(dp) :: total(3), flux, volume, area(most_side_nodes), outward(3, most_side_nodes)
    real(wp) :: u(2), w(2)
    integer :: side, n, node(most_side_nodes)
    mesh = made_quadratic(made_hybrid([3, 3]), .false., 0.1_dp)
    call connect_mesh(mesh)
    volume = 9.0_dp
    do side = 1, size(mesh%side_element)
      call share_side(mesh, side, n, node, area, outward)
      u = mesh%x(:, node(2)) - mesh%x(:, node(1))
      w = mesh%x(:, node(3)) - mesh%x(:, node(1))
      volume = volume + 2.0_dp/3.0_dp*(u(2)*w(1) - u(1)*w(2))
    end do
    call sum_shares(mesh, total, flux)
    call check(maxval(abs(total)), 0.0_dp, 1.0e-13_dp, "bulged sides: a closed surface has no net area")
    call check(flux, 2*volume, 1.0e-12_dp, "bulged sides: flux of x is twice the area")
    call check_true(abs(volume - 9.0_dp) > 1.0e-3_dp, "they do bulge")
  end subroutine test_bulged

  !> Halves of an edge, 1/6 and 4/6 of one with a middle node, thirds of a triangle, quarters of a square, with the outward side
  subroutine test_edge_shares()
    type(mesh_t) :: mesh
    real(dp) :: area(most_side_nodes), outward(3, most_side_nodes)
    integer :: n, node(most_side_nodes)
    mesh = made_quads([1, 1])
    mesh%x(1, :) = 3*mesh%x(1, :)
    call connect_mesh(mesh)
    call share_side(mesh, 1, n, node, area, outward)
    call check(n, 2, "an edge has two nodes")
    call check(area(:2), [1.5_dp, 1.5_dp], 0.0_dp, "halves of an edge")
    call check(outward(:, 1), [0.0_dp, -1.5_dp, 0.0_dp], 0.0_dp, "the lower edge looks down")
    mesh = made_quadratic(made_quads([1, 1]), .true.)
    mesh%x(1, :) = 3*mesh%x(1, :)
    call connect_mesh(mesh)
    call share_side(mesh, 1, n, node, area, outward)
    call check(n, 3, "an edge with a middle")
    call check(area(:3), [0.5_dp, 0.5_dp, 2.0_dp], 4*round_off, "one sixth at the ends, four in the middle")
    call check(outward(:, 3), [0.0_dp, -2.0_dp, 0.0_dp], 4*round_off, "which looks down")
    mesh = made_tetrahedra([1, 1, 1])
    call connect_mesh(mesh)
    call share_side(mesh, 1, n, node, area, outward)
    call check(area(:3), spread(1.0_dp/6.0_dp, 1, 3), round_off, "thirds of a triangle of half a square")
    mesh = made_hexahedra([1, 1, 1])
    call connect_mesh(mesh)
    call share_side(mesh, 1, n, node, area, outward)
    call check(area, spread(0.25_dp, 1, 4), round_off, "quarters of a square")
    call check(outward(:, 4), [0.0_dp, 0.0_dp, -0.25_dp], round_off, "the bottom looks down")
  end subroutine test_edge_shares

  !> Work on a velocity that is linear in x: the moment int x dA of a plane side is exact, in the middle of a trapezium too
  subroutine test_linear_traction()
    type(mesh_t) :: mesh
    real(dp) :: area(most_side_nodes), outward(3, most_side_nodes), moment(2)
    integer :: n, node(most_side_nodes), k
    mesh = made_hexahedra([1, 1, 1])
    where (mesh%x(2, :) > 0.5_wp) mesh%x(1, :) = 0.5_wp*mesh%x(1, :) ! bottom with edges 1 below and 1/2 above
    call connect_mesh(mesh)
    call share_side(mesh, 1, n, node, area, outward)
    moment = 0.0_dp
    do k = 1, n
      moment = moment + area(k)*mesh%x(:2, node(k))
    end do
    call check(sum(area), 0.75_dp, 2*round_off, "area of a trapezium")
    call check(moment, [7.0_dp/24.0_dp, 1.0_dp/3.0_dp], 2*round_off, "first moments of it") ! int (1 - y/2)^2/2 dy, int y (1 - y/2) dy
  end subroutine test_linear_traction

  !> Forces reach the nodes of mass, each rank books its own slots, and what is booked is what was given
  subroutine test_nodes()
    type(mesh_t) :: mesh
    type(engine_t) :: engine
    type(loads_t) :: loads
    real(wp), allocatable :: raw(:, :, :), g(:, :, :)
    real(dp) :: turned(3), force(3), work
    integer :: i, s, lost, value, on_side
    mesh = made_quads([9, 19]) ! 200 nodes: slots 0 to 3, the last not full
    call connect_mesh(mesh)
    engine%grid%is_mesh = .true.
    engine%table%slots = 4
    engine%table%booked = [.true., .true., .true., .true.]
    call clear_table(engine%table%slot_of, 4)
    do s = 1, 4
      call insert_key(engine%table%slot_of, block_key([s - 1, 0, 0]), s, value)
    end do
    call check_true(.not. has_loads(loads), "no loads at first")
    allocate (loads%side(2))
    loads%side(1)%group = 2 ! x_high, 20 nodes: 10, 20, ..
    loads%side(1)%vector = [3.0_dp, -1.0_dp, 0.0_dp]
    loads%side(2)%group = 4 ! y_high, nodes 191 to 200
    loads%side(2)%pressure = 7.0_dp
    loads%side(2)%table%ramp_time = 2.0_dp
    call set_side_loads(loads, mesh, 0.5_dp)
    call check_true(has_loads(loads), "loads on sides are loads")
    allocate (raw(nf, nodes_per_block, 4), g(nf, nodes_per_block, 4), source=0.0_wp)
    g(node_mass, :, :) = 1.0_wp
    call collect_loads(loads, engine, 1.0_dp)
    lost = 0
    call add_loads(loads, engine, 4, g, 0.5_wp, raw, lost, turned)
    call check(lost, 0, "every node has mass")
    force = [3*9.5_dp, -9.5_dp - 0.5_dp*7*4.5_dp, 0.0_dp]
    call check([sum(raw(5, :, :)), sum(raw(6, :, :)), sum(raw(7, :, :))], real(force, wp), 1.0e-13_wp, "nodes have the traction and half the pressure")
    call check(sum_of_loads(loads), force, 1.0e-13_dp, "and so do the books")
    call check(raw(6, 1 + modulo(194, 64), 4), -0.5_wp*7*0.5_wp, 1.0e-14_wp, "a pressure pushes into the mesh")
    do i = 1, mesh%nodes
      g(1:2, 1 + modulo(i - 1, 64), 1 + (i - 1)/64) = mesh%x(:, i) ! velocity x, the change twice as fast
      g(5:6, 1 + modulo(i - 1, 64), 1 + (i - 1)/64) = 2*mesh%x(:, i)
    end do
    work = 3*9.5_dp*9 - 9.5_dp*9.5_dp - 0.5_dp*7*4.5_dp*19
    call check(work_of_loads(loads, engine, 4, g, 0.25_dp, 0.25_wp), 0.125_dp*work, 1.0e-12_dp, "work with a share of the change")

    on_side = count([(mesh%x(1, i) > 8.5_wp .or. mesh%x(2, i) > 18.5_wp, i=65, 128)]) ! no node of slot 2 is in two groups
    g(node_mass, :, 2) = 0.0_wp
    engine%table%booked(3) = .false.
    raw = 0.0_wp
    lost = 0
    call add_loads(loads, engine, 4, g, 0.5_wp, raw, lost, turned)
    call check(maxval(abs(raw(5:7, :, 2))), 0.0_wp, 0.0_wp, "nodes without mass take no force")
    call check_true(any(abs(raw(5:7, :, 3)) > 0.0_wp), "slots that another rank books do")
    on_side = on_side + count([(mesh%x(1, i) > 8.5_wp .or. mesh%x(2, i) > 18.5_wp, i=129, 192)])
    call check(lost, on_side, "nodes that nobody books are counted (no other rank is here)")
    raw(:, :, 3) = 0.0_wp
    call check(sum_of_loads(loads), real([sum(raw(5, :, :)), sum(raw(6, :, :)), 0.0_wp], dp), 1.0e-13_dp, "books have what nodes got")
    call collect_loads(loads, engine, 0.0_dp)
    loads%side(1)%now = 0.0_dp
    lost = 0
    call add_loads(loads, engine, 4, g, 0.5_wp, raw, lost, turned)
    call check(lost, 0, "loads of factor zero lose nothing")
    call check(sum_of_loads(loads), [0.0_dp, 0.0_dp, 0.0_dp], 0.0_dp, "and give nothing")
  end subroutine test_nodes

end program test_side_loads
