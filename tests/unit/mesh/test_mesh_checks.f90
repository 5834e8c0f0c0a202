!> Every bad mesh has its message, which names elements and says what to do; sound meshes that look odd have none
program test_mesh_checks
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use gimp_kinds, only: wp, dp
  use gimp_error, only: error_t, report_lines
  use gimp_file_system, only: delete_file
  use gimp_mesh, only: mesh_t, line2, triangle3, triangle6, quad4, tetrahedron4, hexahedron8
  use gimp_mesh_file, only: read_mesh
  use gimp_made_meshes, only: made_lines, made_triangles, made_quads, made_hybrid, made_tetrahedra, made_hexahedra, made_quadratic, &
    write_made_mesh
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  character(len=*), parameter :: path = "test_mesh_checks.h5"
  real(wp), parameter :: cube(3, 8) = reshape(real([0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0, 0, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1], wp), [3, 8])
  type(error_t), allocatable :: error

  call begin_suite("mesh checks")
  call test_numbers()
  call test_elements()
  call test_shapes()
  call test_neighbours()
  call test_hanging_nodes()
  call test_unmerged_nodes()
  call test_solids()
  call test_named_sides()
  call test_sound()
  call delete_file(path, error)
  call end_suite()

contains

  !> Numbers and coordinates
  subroutine test_numbers()
    type(mesh_t) :: mesh
    mesh = made_hybrid([4, 3])
    mesh%node(2, 3) = 0
    mesh%node(1, mesh%elements) = 21
    call refused(mesh, "elements with nodes that are not there: triangle3 element 3, quad4 element ", "numbered from 1 to 20")
    mesh = made_quads([4, 3])
    mesh%x(2, 7) = ieee_value(1.0_wp, ieee_quiet_nan)
    call refused(mesh, "coordinates that are not finite numbers: node 7;", "correct or remove")
    mesh = made_quads([2, 1])
    mesh%element_group = [1, 3]
    mesh%element_group_name = [character(len=32) :: "sand", "clay"]
    call refused(mesh, "elements in a group that is not there: quad4 element 2;", "from 1 to 2")
    mesh = made_quads([2, 1])
    mesh%named_side_group(2:3) = [0, 5]
    call refused(mesh, "rows of sides/group that name no group: side 2, side 3;", "from 1 to 4")
    mesh = made_quads([2, 1])
    mesh%named_side_node(:, 2) = 0
    mesh%named_side_node(2, 4) = 7
    call refused(mesh, "rows of sides/nodes with nodes that are not there: side 2, side 4;", "from 1 to 6")
    mesh%node(1, 1) = -5
    call refused(mesh, "elements with nodes that are not there: quad4 element 1;", "from 1 to 6", mistakes=2)
  end subroutine test_numbers

  !> Elements and nodes that are too many
  subroutine test_elements()
    type(mesh_t) :: mesh
    integer :: k
    mesh = made_triangles([4, 3])
    mesh%node(3, 5) = mesh%node(1, 5)
    call refused(mesh, "elements with the same node twice: triangle3 element 5;", "distinct nodes")
    mesh = made_quads([4, 3])
    call add_elements(mesh, 2)
    mesh%node(:, 13) = mesh%node([3, 4, 1, 2], 5)
    mesh%node(:, 14) = mesh%node([2, 1, 4, 3], 6) ! inside out, too
    call refused(mesh, "elements that are there twice: quad4 element 13 (as quad4 element 5), quad4 element 14 (as quad4 element 6);", &
      "remove one of each", mistakes=2)
    mesh = made_quads([4, 3])
    mesh%x = reshape([mesh%x, [(9.0_wp, k=1, 16)]], [2, 28])
    call number_nodes(mesh)
    call refused(mesh, "nodes that no element has: node 21, node 22, node 23, node 24, node 25 and 3 more;", "remove them")
  end subroutine test_elements

  !> Elements that are wrong by their shape
  subroutine test_shapes()
    type(mesh_t) :: mesh
    integer :: e
    mesh = made_hybrid([4, 3])
    do e = 1, mesh%elements
      if (e <= 7) mesh%node(:3, e) = mesh%node([1, 3, 2], e)
      if (e == mesh%elements) mesh%node(:, e) = mesh%node([4, 3, 2, 1], e)
    end do
    call refused(mesh, "inverted elements (negative volume): triangle3 element 1, triangle3 element 2, triangle3 element 3, " &
      //"triangle3 element 4, triangle3 element 5 and 3 more;", "reverse the order of their nodes")
    mesh = made_lines(3)
    mesh%node(:, 2) = mesh%node([2, 1], 2)
    call refused(mesh, "inverted elements (negative volume): line2 element 2;", "reverse the order")
    mesh = made_tetrahedra([1, 1, 1])
    mesh%node(:, 4) = mesh%node([2, 1, 3, 4], 4)
    call refused(mesh, "inverted elements (negative volume): tetrahedron4 element 4;", "reverse the order")
    mesh = mesh_of(2, [triangle3], [1, 2, 3], real([0, 0, 1, 0, 2, 0], wp))
    call refused(mesh, "no element of the mesh has a volume", "another dimension?")
    mesh = mesh_of(2, [triangle3, triangle3], [1, 2, 3, 2, 4, 3], real([0, 0, 1, 0, 2, 0, 1, -1], wp))
    call refused(mesh, "elements without volume: triangle3 element 1;", "move nodes or leave the elements out")
    mesh = mesh_of(2, [triangle3, triangle3], [1, 2, 3, 2, 4, 3], [0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.5_wp, 0.009_wp, 2.0_wp, 2.0_wp])
    call refused(mesh, "badly shaped elements (smallest height over longest edge): triangle3 element 1 (0.009);", "at least 0.01")
    mesh = made_quads([3, 3])
    mesh%x(:, 6) = [1.5_wp, 1.5_wp]
    call refused(mesh, "badly shaped elements (smallest Jacobian over its mean): quad4 element 5 (", "at least 0.05")
    mesh = made_quads([1, 1])
    mesh%node(:, 1) = mesh%node([1, 2, 4, 3], 1)
    mesh%x(:, 2) = [2.0_wp, -0.5_wp] ! a bow-tie with an area
    call refused(mesh, "quad4 element 1", "order of their nodes")
    mesh = made_quadratic(made_quads([2, 1]), .false.)
    mesh%x(:, mesh%node(5, 2)) = [1.05_wp, 0.0_wp] ! the middle of a side near its end
    call refused(mesh, "badly shaped elements (smallest Jacobian over its mean): quad8 element 2 (-", "at least 0.05")
    mesh = made_hexahedra([2, 1, 1])
    mesh%x(:, mesh%node(7, 1)) = [0.4_wp, 0.4_wp, 0.4_wp]
    call refused(mesh, "badly shaped elements (smallest Jacobian over its mean): hexahedron8 element 1 (-", "at least 0.05")
  end subroutine test_shapes

  !> What two elements at a common side can do wrong
  subroutine test_neighbours()
    type(mesh_t) :: mesh
    mesh = mesh_of(2, [triangle3, triangle3], [1, 2, 3, 1, 2, 4], real([0, 0, 4, 0, 1, 3, 3, 2], wp))
    call refused(mesh, "neighbours on the same side of their common side: triangle3 element 1 and triangle3 element 2;", "they overlap")
    mesh = mesh_of(1, [line2, line2], [1, 2, 1, 3], real([0, 1, 2], wp))
    call refused(mesh, "neighbours on the same side of their common side: line2 element 1 and line2 element 2;", "they overlap")
    mesh = mesh_of(3, [tetrahedron4, tetrahedron4], [1, 2, 3, 4, 1, 2, 3, 5], &
      real([0, 0, 0, 3, 0, 0, 0, 3, 0, 0, 0, 3, 1, 1, 2], wp))
    call refused(mesh, "neighbours on the same side of their common side: tetrahedron4 element 1 and tetrahedron4 element 2;", "overlap")
    mesh = mesh_of(2, [triangle3, triangle3, triangle3], [1, 2, 3, 2, 1, 4, 1, 2, 5], real([0, 0, 4, 0, 2, 3, 2, -3, 2, 1], wp))
    call refused(mesh, "more than two elements on a side: triangle3 element 3 (on a side that triangle3 element 1 and triangle3 element 2 " &
      //"share);", "remove those that overlap")
    mesh = mesh_of(2, [triangle3, triangle6], [1, 2, 3, 0, 0, 0, 2, 1, 4, 5, 6, 7], &
      real([0, 0, 4, 0, 2, 3, 2, -4, 2, 0, 1, -2, 3, -2], wp))
    call refused(mesh, "neighbours that do not share the node within their common side: triangle3 element 1 and triangle6 element 1;", &
      "linear and quadratic elements cannot be neighbours")
  end subroutine test_neighbours

  !> Nodes on sides of elements that do not have them
  subroutine test_hanging_nodes()
    type(mesh_t) :: mesh
    integer, parameter :: left(4) = [1, 2, 3, 4], right(8) = [2, 5, 6, 7, 7, 6, 8, 3]
    ! a quad beside two that are half as high, also when all is turned
    mesh = mesh_of(2, [quad4, quad4, quad4], [left, right], real([0, 0, 2, 0, 2, 2, 0, 2, 3, 0, 3, 1, 2, 1, 3, 2], wp))
    call refused(mesh, "hanging nodes (on a side of an element that does not have them): node 7 on quad4 element 1;", "split that element")
    mesh%x = matmul(reshape([0.6_wp, 0.8_wp, -0.8_wp, 0.6_wp], [2, 2]), mesh%x)
    call refused(mesh, "hanging nodes (on a side of an element that does not have them): node 7 on quad4 element 1;", "split that element")
    mesh%x(1, 7) = mesh%x(1, 7) + 1.0e-6_wp ! files of six digits
    call refused(mesh, "hanging nodes (on a side of an element that does not have them): node 7 on quad4 element 1;", "split that element")
    ! pieces that have no node in common
    mesh = mesh_of(2, [quad4, quad4], [1, 2, 3, 4, 5, 6, 7, 8], real([0, 0, 8, 0, 8, 8, 0, 8, 8, 3, 9, 3, 9, 5, 8, 5], wp))
    call refused(mesh, "hanging nodes (on a side of an element that does not have them): node 5 on quad4 element 1, node 8 on quad4 element 1;", &
      "split that element")
    ! a curved side between two straight ones: its node within is a corner of theirs
    mesh = mesh_of(2, [triangle3, triangle3, triangle6], [1, 2, 3, 0, 0, 0, 2, 4, 3, 0, 0, 0, 4, 1, 5, 2, 6, 7], &
      real([0, 0, 4, 1, 4, 5, 8, 0, 4, -6, 2, -3, 6, -3], wp))
    call refused(mesh, "hanging nodes (on a side of an element that does not have them): node 2 on triangle6 element 1;", "split that element")
  end subroutine test_hanging_nodes

  !> Nodes that should be one
  subroutine test_unmerged_nodes()
    type(mesh_t) :: mesh
    mesh = mesh_of(2, [quad4, quad4], [1, 2, 3, 4, 5, 6, 7, 8], real([0, 0, 1, 0, 1, 1, 0, 1, 1, 0, 2, 0, 2, 1, 1, 1], wp))
    call refused(mesh, "different nodes at the same place: node 2 and node 5, node 3 and node 8;", "merge them")
    mesh%x(1, 5) = 1.0_wp + 1.0e-6_wp ! files of six digits
    call refused(mesh, "different nodes at the same place: node 2 and node 5, node 3 and node 8;", "merge them")
    mesh = mesh_of(1, [line2, line2], [1, 2, 3, 4], real([0, 1, 1, 2], wp))
    call refused(mesh, "different nodes at the same place: node 2 and node 3;", "merge them")
    mesh = made_hexahedra([2, 1, 1])
    mesh%x = reshape([mesh%x, mesh%x(:, mesh%node(3, 1))], [3, mesh%nodes + 1])
    call number_nodes(mesh)
    mesh%node(3, 1) = mesh%nodes
    deallocate (mesh%named_side_node, mesh%named_side_group)
    allocate (mesh%named_side_node(4, 0), mesh%named_side_group(0))
    call refused(mesh, "different nodes at the same place: node 5 and node 13;", "merge them")
  end subroutine test_unmerged_nodes

  !> Faces that do not match
  subroutine test_solids()
    type(mesh_t) :: mesh
    integer :: k
    ! a cube beside two tetrahedra on one of its faces
    mesh = mesh_of(3, [tetrahedron4, tetrahedron4, hexahedron8], [2, 3, 6, 9, 0, 0, 0, 0, 6, 3, 7, 9, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8], &
      [reshape(cube, [24]), 2.0_wp, 0.5_wp, 0.5_wp])
    call refused(mesh, "boundary sides that cover each other: hexahedron8 element 1 and tetrahedron4 element 1, tetrahedron4 element 2 and " &
      //"hexahedron8 element 1;", "do not fit those of hexahedra")
    ! tetrahedra whose faces cut a square along the other diagonal
    mesh = mesh_of(3, [(tetrahedron4, k=1, 4)], [1, 2, 4, 5, 2, 3, 4, 5, 2, 1, 3, 6, 3, 1, 4, 6], &
      0.5_wp*real([2, 0, 0, 2, 2, 0, 2, 2, 2, 2, 0, 2, 4, 1, 1, 0, 1, 1], wp))
    call refused(mesh, "boundary sides that cover each other: tetrahedron4 element ", "all nodes of their common side in common")
    ! four small cubes beside a large one, a face apart that is not flat
    mesh = made_hexahedra([1, 2, 2])
    call add_elements(mesh, 1)
    mesh%x = reshape([mesh%x, reshape(real([-2, 0, 0, -2, 2, 0, -2, 2, 2, -2, 0, 2], wp), [12])], [3, mesh%nodes + 4])
    call number_nodes(mesh)
    mesh%node(:, 5) = [19, 1, 5, 20, 22, 13, 17, 21]
    do k = 1, 17
      if (mesh%x(1, k) < 0.5_wp) mesh%x(1, k) = mesh%x(1, k) + 0.1_wp*mesh%x(2, k)*mesh%x(3, k) ! bilinear, as the face of a hexahedron
    end do
    deallocate (mesh%named_side_node, mesh%named_side_group)
    allocate (mesh%named_side_node(4, 0), mesh%named_side_group(0))
    call refused(mesh, "hanging nodes (on a side of an element that does not have them): node 3 on hexahedron8 element 5, ", "split that element")
    call check_true(index(error%message, " and ") == 0 .and. index(error%message, "node 9 on hexahedron8 element 5") > 0, &
      "hanging nodes of cubes: five are named in '"//error%message//"'")
  end subroutine test_solids

  !> Names for what is no boundary side
  subroutine test_named_sides()
    type(mesh_t) :: mesh
    mesh = made_quads([2, 1])
    mesh%named_side_node(:2, 3) = [1, 6]
    call refused(mesh, "named sides that are no side of an element: 'x_", "give the corners of one side of one element")
    mesh = made_quads([2, 1])
    mesh%named_side_node(:2, 1) = [5, 2]
    call refused(mesh, "named sides inside of the mesh: 'y_low' at node 5 node 2 between quad4 element 1 and quad4 element 2;", &
      "only sides on its boundary")
    mesh = made_quads([2, 1])
    mesh%named_side_node(:, 2) = mesh%named_side_node([2, 1, 3, 4], 1)
    call refused(mesh, "sides with two names: '", "leave one name to each")
    mesh%named_side_group(2) = mesh%named_side_group(1)
    call accepted(mesh, "a side named twice, with the same name")
    mesh = made_quadratic(made_quads([2, 1]), .false.)
    mesh%named_side_node(3, 1) = mesh%node(5, 1)
    call refused(mesh, "named sides that are no side of an element: 'y_low' at node 1 node 2 node 7;", "without the nodes between them")
  end subroutine test_named_sides

  !> Odd, but sound
  subroutine test_sound()
    type(mesh_t) :: mesh
    integer :: e
    mesh = mesh_of(2, [quad4, quad4], [1, 2, 3, 4, 5, 6, 7, 8], real([0, 0, 1, 0, 1, 1, 0, 1, 5, 0, 6, 0, 6, 1, 5, 1], wp))
    call accepted(mesh, "two pieces")
    mesh = mesh_of(2, [quad4, quad4], [1, 2, 3, 4, 3, 5, 6, 7], real([0, 0, 1, 0, 1, 1, 0, 1, 2, 1, 2, 2, 1, 2], wp))
    call accepted(mesh, "two quads at one vertex")
    mesh = mesh_of(3, [hexahedron8, hexahedron8], [1, 2, 3, 4, 5, 6, 7, 8, 3, 9, 10, 11, 7, 12, 13, 14], &
      [reshape(cube, [24]), real([2, 1, 0, 2, 2, 0, 1, 2, 0, 2, 1, 1, 2, 2, 1, 1, 2, 1], wp)])
    call accepted(mesh, "two cubes at one edge")
    mesh = made_quads([10, 10])
    mesh%x(1, :) = mesh%x(1, :)*1.0e-3_wp
    call accepted(mesh, "thin layers")
    mesh%x(1, :) = (1.0_wp + 1.0e3_wp*mesh%x(1, :))**5
    call accepted(mesh, "elements of very different sizes")
    mesh = made_quadratic(made_hybrid([8, 8], 0.2_dp), .false., 0.07_dp)
    call accepted(mesh, "curved sides")
    mesh = made_triangles([12, 9], 0.3_dp)
    call accepted(mesh, "distorted triangles")
    mesh = made_tetrahedra([3, 3, 3], 0.2_dp)
    call accepted(mesh, "distorted tetrahedra")
    mesh = made_hexahedra([4, 4, 4], 0.25_dp)
    call accepted(mesh, "distorted hexahedra")
    ! a funnel: boundary sides that come near each other, but do not touch
    mesh = made_quads([20, 1])
    do e = 1, mesh%nodes
      mesh%x(:, e) = [cos(0.3_wp*mesh%x(1, e)), sin(0.3_wp*mesh%x(1, e))]*(1.0_wp + mesh%x(2, e))
    end do
    mesh%node = mesh%node([4, 3, 2, 1], :)
    call accepted(mesh, "a ring that is not quite closed")
  end subroutine test_sound

  !> A mesh from its elements; nodes of all elements one after the other, as many for each as the largest has
  function mesh_of(dim, kinds, nodes, x) result(mesh)
    integer, intent(in) :: dim, kinds(:), nodes(:)
    real(wp), intent(in) :: x(:)
    type(mesh_t) :: mesh
    integer :: k
    mesh%dim = dim
    mesh%elements = size(kinds)
    allocate (mesh%kind, source=kinds)
    mesh%node = reshape(nodes, [size(nodes)/size(kinds), size(kinds)])
    mesh%element_in_file = [(count(kinds(:k) == kinds(k)), k=1, size(kinds))]
    mesh%x = reshape(x, [dim, size(x)/dim])
    call number_nodes(mesh)
    allocate (mesh%side_group_name(0), mesh%named_side_node(4, 0), mesh%named_side_group(0))
  end function mesh_of

  subroutine number_nodes(mesh)
    type(mesh_t), intent(inout) :: mesh
    integer :: k
    mesh%nodes = size(mesh%x, 2)
    mesh%node_in_file = [(k, k=1, mesh%nodes)]
  end subroutine number_nodes

  !> Room for more elements of the last kind
  subroutine add_elements(mesh, more)
    type(mesh_t), intent(inout) :: mesh
    integer, intent(in) :: more
    integer :: k, n
    n = mesh%elements
    mesh%node = reshape([mesh%node, [(0, k=1, more*size(mesh%node, 1))]], [size(mesh%node, 1), n + more])
    mesh%kind = [mesh%kind, [(mesh%kind(n), k=1, more)]]
    mesh%element_in_file = [mesh%element_in_file, [(mesh%element_in_file(n) + k, k=1, more)]]
    mesh%elements = n + more
  end subroutine add_elements

  !> Reading is refused with a message that has both parts
  subroutine refused(mesh, part, remedy, mistakes)
    type(mesh_t), intent(in) :: mesh
    character(len=*), intent(in) :: part, remedy
    integer, intent(in), optional :: mistakes !! 1 if absent
    integer :: n
    call read_back(mesh)
    call check_true(allocated(error), part//": refused")
    if (.not. allocated(error)) return
    n = 1
    if (present(mistakes)) n = mistakes
    call check_true(index(error%message, part) > 0, part//": told as '"//error%message//"'")
    call check_true(index(error%message, remedy) > 0, part//": says what to do in '"//error%message//"'")
    call check(report_lines(error), n, part//": mistakes told in '"//error%message//"'")
  end subroutine refused

  subroutine accepted(mesh, what)
    type(mesh_t), intent(in) :: mesh
    character(len=*), intent(in) :: what
    call read_back(mesh)
    if (allocated(error)) then
      call check_true(.false., what//": refused: "//error%message)
    else
      call check_true(.true., what)
    end if
  end subroutine accepted

  subroutine read_back(mesh)
    type(mesh_t), intent(in) :: mesh
    type(mesh_t) :: back
    real(dp) :: lower(3), spacing
    call write_made_mesh(path, mesh, [0.0_dp, 0.0_dp, 0.0_dp], 0.1_dp)
    spacing = 0.0_dp
    call read_mesh(path, mesh%dim, lower, spacing, back, error)
  end subroutine read_back

end program test_mesh_checks
