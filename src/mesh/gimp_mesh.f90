!> An unstructured mesh: nodes, elements of several kinds, who neighbours whom, named groups of elements and of boundary sides.
!>
!> Lengths are in units of the grid's spacing from its corner, as positions of particles are (`to_cells` of the reader). Nodes and elements are
!> numbered so that those of a patch stand together (see gimp_patches); messages give the numbers of the file.
!>
!> Kinds and the order of their nodes are those of VTK: corners first (2D counter-clockwise), then middles of sides (side s from corner s
!> to corner s + 1), then the centre.
module gimp_mesh
  use gimp_kinds, only: wp
  use gimp_text, only: text_of
  implicit none(type, external)
  private
  public :: mesh_t
  public :: line2, triangle3, triangle6, quad4, quad8, quad9, tetrahedron4, hexahedron8, n_kinds
  public :: kind_name, kind_dim, kind_nodes, kind_corners, kind_sides, side_corners, side_of_kind, most_side_corners
  public :: group_name_length, side_nodes, middle_node, element_label

  integer, parameter :: line2 = 1, triangle3 = 2, triangle6 = 3, quad4 = 4, quad8 = 5, quad9 = 6, tetrahedron4 = 7, hexahedron8 = 8, &
    n_kinds = 8
  character(len=12), parameter :: kind_name(n_kinds) = [character(len=12) :: "line2", "triangle3", "triangle6", "quad4", "quad8", &
    "quad9", "tetrahedron4", "hexahedron8"] !! also the names of their tables in a mesh file
  integer, parameter :: kind_dim(n_kinds) = [1, 2, 2, 2, 2, 2, 3, 3]
  integer, parameter :: kind_nodes(n_kinds) = [2, 3, 6, 4, 8, 9, 4, 8]
  integer, parameter :: kind_corners(n_kinds) = [2, 3, 3, 4, 4, 4, 4, 8]
  integer, parameter :: kind_sides(n_kinds) = [2, 3, 3, 4, 4, 4, 4, 6] !! sides are points, edges or faces
  integer, parameter :: side_corners(n_kinds) = [1, 2, 2, 2, 2, 2, 3, 4] !! corners of each side
  integer, parameter :: most_side_corners = 4
  integer, parameter :: group_name_length = 32

  !> Corners of the faces of solids, seen from outside counter-clockwise
  integer, parameter :: tetrahedron_faces(3, 4) = reshape([1, 3, 2, 1, 2, 4, 2, 3, 4, 3, 1, 4], [3, 4])
  integer, parameter :: hexahedron_faces(4, 6) = reshape([1, 4, 3, 2, 5, 6, 7, 8, 1, 2, 6, 5, 2, 3, 7, 6, 3, 4, 8, 7, 4, 1, 5, 8], [4, 6])

  type :: mesh_t
    integer :: dim = 0
    integer :: nodes = 0, elements = 0
    real(wp), allocatable :: x(:, :) !! (dim, node) [cells]
    integer, allocatable :: kind(:) !! (element)
    integer, allocatable :: node(:, :) !! (most nodes of an element here, element); 0 beyond those of its kind
    integer, allocatable :: node_in_file(:), element_in_file(:) !! numbers for messages; elements count within their kind
    character(len=group_name_length), allocatable :: element_group_name(:)
    integer, allocatable :: element_group(:) !! (element) 0: none
    ! named sides, as the file has them
    integer, allocatable :: named_side_node(:, :) !! (most_side_corners, named side) corners in any order; 0 beyond them
    integer, allocatable :: named_side_group(:) !! (named side)
    character(len=group_name_length), allocatable :: side_group_name(:)
    ! connections, made by connect_mesh
    integer, allocatable :: vertex_first(:) !! (node + 1) where its elements begin in `vertex_element`
    integer, allocatable :: vertex_element(:) !! elements that have a node as a corner, ascending
    integer, allocatable :: across(:, :) !! (most sides of an element here, element) element beyond a side, or minus the number of a
    !! boundary side; 0 beyond the sides of its kind
    ! boundary sides, numbered in the order of elements and sides
    integer, allocatable :: side_element(:), side_number(:) !! (boundary side) the element it belongs to, and which of its sides it is
    integer, allocatable :: side_group(:) !! (boundary side) 0: none
  end type mesh_t

contains

  !> Corners of side s of an element of a kind, as places 1, 2, .. in its list of nodes; outward by the right-hand rule
  pure function side_of_kind(kind, s) result(corner)
    integer, intent(in) :: kind, s
    integer :: corner(most_side_corners)
    corner = 0
    select case (kind_dim(kind))
    case (1)
      corner(1) = s
    case (2)
      corner(:2) = [s, 1 + modulo(s, kind_corners(kind))]
    case default
      if (kind == tetrahedron4) then
        corner(:3) = tetrahedron_faces(:, s)
      else
        corner = hexahedron_faces(:, s)
      end if
    end select
  end function side_of_kind

  !> Nodes at the corners of side s of element e, 0 beyond them; outward by the right-hand rule
  pure function side_nodes(mesh, e, s) result(node)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e, s
    integer :: node(most_side_corners)
    integer :: corner(most_side_corners), k
    corner = side_of_kind(mesh%kind(e), s)
    node = 0
    do k = 1, side_corners(mesh%kind(e))
      node(k) = mesh%node(corner(k), e)
    end do
  end function side_nodes

  !> The node within side s of element e if that is quadratic, else 0
  pure integer function middle_node(mesh, e, s)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e, s
    middle_node = 0
    if (mesh%kind(e) == triangle6) middle_node = mesh%node(3 + s, e)
    if (mesh%kind(e) == quad8 .or. mesh%kind(e) == quad9) middle_node = mesh%node(4 + s, e)
  end function middle_node

  !> An element as messages name it: "triangle3 element 17", the number being that of the file
  pure function element_label(mesh, e) result(label)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    character(len=:), allocatable :: label
    label = trim(kind_name(mesh%kind(e)))//" element "//text_of(mesh%element_in_file(e))
  end function element_label

end module gimp_mesh
