!> Connections of made meshes against a search over all pairs of elements, and against numbers known beforehand
program test_mesh_connect
  use gimp_kinds, only: wp, dp
  use gimp_mesh, only: mesh_t, kind_nodes, kind_corners, kind_sides, side_nodes, element_label, most_side_corners, triangle3
  use gimp_mesh_connect, only: connect_mesh, find_side
  use gimp_mesh_renumber, only: renumber_mesh
  use gimp_made_meshes, only: made_lines, made_triangles, made_quads, made_hybrid, made_tetrahedra, made_hexahedra, made_quadratic, &
    random_t, random_number_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  call begin_suite("mesh connections")
  call test_mesh("lines", made_lines(7, 0.3_dp), 2)
  call test_mesh("triangles", made_triangles([5, 4], 0.3_dp), 18)
  call test_mesh("quads", made_quads([5, 4], 0.3_dp), 18)
  call test_mesh("hybrid", made_hybrid([6, 4], 0.3_dp), 20)
  call test_mesh("tetrahedra", made_tetrahedra([3, 2, 4], 0.2_dp), 4*(3*2 + 2*4 + 3*4))
  call test_mesh("hexahedra", made_hexahedra([3, 2, 4], 0.3_dp), 2*(3*2 + 2*4 + 3*4))
  call test_mesh("triangle6", made_quadratic(made_triangles([4, 3]), .false.), 14)
  call test_mesh("quad8 and triangle6", made_quadratic(made_hybrid([4, 3], 0.2_dp), .false., 0.1_dp), 14)
  call test_mesh("quad9", made_quadratic(made_quads([4, 3]), .true.), 14)
  call test_crowded_side()
  call test_quadratic_nodes()
  call end_suite()

contains

  !> As made, and with other numbers
  subroutine test_mesh(name, made, boundary)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: made
    integer, intent(in) :: boundary !! sides
    type(mesh_t) :: mesh
    integer :: element_order(made%elements), node_order(made%nodes)
    mesh = made
    call connect_mesh(mesh)
    call check(size(mesh%side_element), boundary, name//": boundary sides")
    call check_connections(name, mesh)
    element_order = shuffled(made%elements)
    node_order = shuffled(made%nodes)
    call renumber_mesh(mesh, element_order, node_order)
    call check_true(.not. allocated(mesh%across), name//": connections are forgotten with the numbers")
    call check_same(name, made, mesh, element_order, node_order)
    call connect_mesh(mesh)
    call check_connections(name//" with other numbers", mesh)
  end subroutine test_mesh

  !> The numbers 1 to n in random order
  function shuffled(n) result(order)
    integer, intent(in) :: n
    integer :: order(n)
    type(random_t) :: random
    integer :: i, k
    do i = 1, n
      k = 1 + int(i*random_number_of(random))
      order(i) = order(k)
      order(k) = i
    end do
  end function shuffled

  subroutine check_same(name, old, new, element_order, node_order)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: old, new
    integer, intent(in) :: element_order(:), node_order(:)
    integer :: e, n
    logical :: same
    same = all(old%node_in_file(node_order) == new%node_in_file)
    do e = 1, new%elements
      n = kind_nodes(new%kind(e))
      same = same .and. element_label(new, e) == element_label(old, element_order(e)) .and. &
        all(old%node_in_file(old%node(:n, element_order(e))) == new%node_in_file(new%node(:n, e))) .and. &
        all(old%x(:, old%node(:n, element_order(e))) == new%x(:, new%node(:n, e)))
    end do
    call check_true(same, name//": the same elements with other numbers")
  end subroutine check_same

  !> All connections by definition
  subroutine check_connections(name, mesh)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: mesh
    integer :: e, s, i, k, n, other, boundary
    integer :: around(mesh%elements)
    logical :: vertices, across, numbers, groups
    vertices = mesh%vertex_first(1) == 1 .and. size(mesh%vertex_element) == mesh%vertex_first(mesh%nodes + 1) - 1
    do i = 1, mesh%nodes
      n = 0
      do e = 1, mesh%elements
        if (all(mesh%node(:kind_corners(mesh%kind(e)), e) /= i)) cycle
        n = n + 1
        around(n) = e
      end do
      vertices = vertices .and. n == mesh%vertex_first(i + 1) - mesh%vertex_first(i)
      if (vertices) vertices = all(mesh%vertex_element(mesh%vertex_first(i):mesh%vertex_first(i + 1) - 1) == around(:n))
    end do
    call check_true(vertices, name//": elements around vertices")

    boundary = 0
    across = .true.
    numbers = .true.
    groups = .true.
    do e = 1, mesh%elements
      do s = 1, kind_sides(mesh%kind(e))
        other = element_with(mesh, side_nodes(mesh, e, s), e)
        if (other > 0) then
          across = across .and. mesh%across(s, e) == other
        else
          boundary = boundary + 1
          across = across .and. mesh%across(s, e) == -boundary
          numbers = numbers .and. mesh%side_element(boundary) == e .and. mesh%side_number(boundary) == s
          k = mesh%side_group(boundary)
          groups = groups .and. side_of_box(mesh, side_nodes(mesh, e, s)) == mesh%side_group_name(max(1, k)) .and. k > 0
        end if
      end do
      across = across .and. all(mesh%across(kind_sides(mesh%kind(e)) + 1:, e) == 0)
    end do
    call check_true(across, name//": elements across sides")
    call check_true(numbers .and. size(mesh%side_element) == boundary, name//": boundary sides know their element")
    call check_true(groups, name//": groups of boundary sides")
  end subroutine check_connections

  !> The other element that has all corners of a side; 0: none
  integer function element_with(mesh, corner, own) result(e)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: corner(:), own
    integer :: k
    do e = mesh%elements, 1, -1
      if (e == own) cycle
      if (all([(corner(k) == 0 .or. any(mesh%node(:kind_corners(mesh%kind(e)), e) == corner(k)), k=1, size(corner))])) return
    end do
  end function element_with

  !> The name that a side on the box should have, from its place
  function side_of_box(mesh, corner) result(name)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: corner(:)
    character(len=6) :: name
    character(len=1), parameter :: axis(3) = ["x", "y", "z"]
    integer :: d, nodes
    logical :: vertex(mesh%nodes) ! nodes within curved sides leave the box
    vertex = mesh%vertex_first(2:) > mesh%vertex_first(:mesh%nodes)
    nodes = count(corner > 0)
    name = "?"
    do d = 1, mesh%dim
      if (all(mesh%x(d, corner(:nodes)) <= minval(mesh%x(d, :), vertex))) name = axis(d)//"_low"
      if (all(mesh%x(d, corner(:nodes)) >= maxval(mesh%x(d, :), vertex))) name = axis(d)//"_high"
    end do
  end function side_of_box

  !> Four triangles on one edge, in vain: the first two are neighbours, and all of them know who was first
  subroutine test_crowded_side()
    type(mesh_t) :: mesh
    integer :: e, s, k
    mesh%dim = 2
    mesh%nodes = 6
    mesh%elements = 4
    mesh%kind = [(triangle3, k=1, 4)]
    mesh%node = reshape([1, 2, 3, 4, 2, 1, 2, 5, 1, 6, 1, 2], [3, 4])
    mesh%node_in_file = [(k, k=1, 6)]
    mesh%element_in_file = [(k, k=1, 4)]
    call connect_mesh(mesh)
    call check(mesh%across(1, 1), 2, "crowded side: beyond the first element")
    call check(mesh%across(2, 2), 1, "crowded side: beyond the second element")
    call check_true(mesh%across(3, 3) < 0 .and. mesh%across(2, 4) < 0, "crowded side: others end there")
    call find_side(mesh, [2, 1, 0, 0], e, s)
    call check_true(e == 1 .and. s == 1, "crowded side: found with its first element")
    call find_side(mesh, [3, 4, 0, 0], e, s)
    call check_true(e == 0 .and. s == 0, "no side between nodes of different elements")
  end subroutine test_crowded_side

  !> Nodes within the sides of quadratic elements: shared by neighbours, in the middle when nothing bulges
  subroutine test_quadratic_nodes()
    type(mesh_t) :: mesh
    integer :: e, s, f, t, corner(most_side_corners)
    logical :: shared, middle
    mesh = made_quadratic(made_hybrid([5, 4], 0.3_dp), .true.)
    call connect_mesh(mesh)
    shared = .true.
    middle = .true.
    do e = 1, mesh%elements
      do s = 1, kind_sides(mesh%kind(e))
        corner = side_nodes(mesh, e, s)
        associate (x => mesh%x(:, mesh%node(kind_corners(mesh%kind(e)) + s, e)))
          middle = middle .and. norm2(x - 0.5_wp*sum(mesh%x(:, corner(:2)), 2)) < 1.0e-12_wp ! lengths of one, rounded
        end associate
        f = mesh%across(s, e)
        if (f < 0) cycle
        t = findloc(mesh%across(:, f), e, dim=1)
        shared = shared .and. mesh%node(kind_corners(mesh%kind(e)) + s, e) == mesh%node(kind_corners(mesh%kind(f)) + t, f)
      end do
    end do
    call check_true(shared, "quadratic: neighbours share the node of their side")
    call check_true(middle, "quadratic: nodes in the middles of sides")
    call check(minval(mesh%node_in_file), 1, "quadratic: nodes have numbers")
  end subroutine test_quadratic_nodes

end program test_mesh_connect
