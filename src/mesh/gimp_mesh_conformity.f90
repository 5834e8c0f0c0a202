!> Whether the elements of a connected mesh fit together: sides of two elements at most, which match node by node, and named sides on the
!> boundary. What should match and does not leaves boundary sides that touch each other; they are found by their places.
module gimp_mesh_conformity
  use gimp_error, only: error_t
  use gimp_mesh, only: mesh_t, kind_sides, side_corners, side_nodes, element_label, most_side_corners, middle_node
  use gimp_mesh_connect, only: find_side
  use gimp_mesh_checks, only: list_t, add_item, tell_list, node_label
  use gimp_mesh_boundary, only: side_t, points_t, make_side, collect_points, points_near, corner_at, lies_on
  implicit none(type, external)
  private
  public :: check_conformity

contains

  !> Everything that neighbours can be wrong about
  subroutine check_conformity(path, mesh, error)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh !! connected, its elements sound by themselves
    type(error_t), allocatable, intent(inout) :: error
    call check_neighbours(path, mesh, error)
    call check_crowds(path, mesh, error)
    call check_contacts(path, mesh, error)
    call check_named_sides(path, mesh, error)
  end subroutine check_conformity

  !> Neighbours lie on different sides of their common side and have the same node within it
  subroutine check_neighbours(path, mesh, error)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(list_t) :: overlapping, middles
    integer :: e, f, s, t
    do e = 1, mesh%elements
      do s = 1, kind_sides(mesh%kind(e))
        f = mesh%across(s, e)
        if (f < e) cycle
        t = findloc(mesh%across(:, f), e, dim=1)
        if (same_sense(mesh, e, s, f, t)) call add_item(overlapping, element_label(mesh, e)//" and "//element_label(mesh, f))
        if (middle_node(mesh, e, s) /= middle_node(mesh, f, t)) &
          call add_item(middles, element_label(mesh, e)//" and "//element_label(mesh, f))
      end do
    end do
    call tell_list(path, "neighbours on the same side of their common side", overlapping, &
      "they overlap: remove one of them or correct its nodes", error)
    call tell_list(path, "neighbours that do not share the node within their common side", middles, &
      "merge it where both have one; linear and quadratic elements cannot be neighbours", error)
  end subroutine check_neighbours

  !> Whether two elements go round the side between them in the same sense, so that their outward normals agree
  pure logical function same_sense(mesh, e, s, f, t)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e, s, f, t
    integer :: a(most_side_corners), b(most_side_corners), n, k
    if (mesh%dim == 1) then
      same_sense = s == t
      return
    end if
    n = side_corners(mesh%kind(e))
    a = side_nodes(mesh, e, s)
    b = side_nodes(mesh, f, t)
    k = findloc(b, a(1), dim=1)
    same_sense = b(1 + modulo(k, n)) == a(2)
    if (n == 2) same_sense = a(1) == b(1)
  end function same_sense

  !> Sides of more than two elements
  subroutine check_crowds(path, mesh, error)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(list_t) :: crowded
    integer :: b, e, s
    do b = 1, size(mesh%side_element)
      call find_side(mesh, side_nodes(mesh, mesh%side_element(b), mesh%side_number(b)), e, s)
      if (e == mesh%side_element(b)) cycle
      call add_item(crowded, element_label(mesh, mesh%side_element(b))//" (on a side that "//element_label(mesh, e)//" and " &
        //element_label(mesh, mesh%across(s, e))//" share)")
    end do
    call tell_list(path, "more than two elements on a side", crowded, "remove those that overlap", error)
  end subroutine check_crowds

  !> Named sides are boundary sides, each with one name
  subroutine check_named_sides(path, mesh, error)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(list_t) :: unknown, inside, renamed
    integer :: k, e, s
    do k = 1, size(mesh%named_side_group)
      call find_side(mesh, mesh%named_side_node(:, k), e, s)
      if (e == 0) then
        call add_item(unknown, named_label(mesh, k))
      else if (mesh%across(s, e) > 0) then
        call add_item(inside, named_label(mesh, k)//" between "//element_label(mesh, e)//" and "//element_label(mesh, mesh%across(s, e)))
      else if (mesh%side_group(-mesh%across(s, e)) /= mesh%named_side_group(k)) then
        call add_item(renamed, named_label(mesh, k)//" and '"//trim(mesh%side_group_name(mesh%side_group(-mesh%across(s, e))))//"'")
      end if
    end do
    call tell_list(path, "named sides that are no side of an element", unknown, &
      "give the corners of one side of one element, without the nodes between them", error)
    call tell_list(path, "named sides inside of the mesh", inside, "only sides on its boundary can have a name; remove the others", error)
    call tell_list(path, "sides with two names", renamed, "leave one name to each", error)
  end subroutine check_named_sides

  !> A named side as messages call it
  function named_label(mesh, k) result(label)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: k
    character(len=:), allocatable :: label
    integer :: i
    label = "'"//trim(mesh%side_group_name(mesh%named_side_group(k)))//"' at"
    do i = 1, most_side_corners
      if (mesh%named_side_node(i, k) > 0) label = label//" "//node_label(mesh, mesh%named_side_node(i, k))
    end do
  end function named_label

  !> Boundary sides that touch where they should be joined: nodes at the same place, hanging nodes, sides that cover each other
  subroutine check_contacts(path, mesh, error)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(list_t) :: same, hanging, covering
    type(points_t) :: points
    type(side_t) :: side
    logical, allocatable :: told(:)
    integer, allocatable :: found(:)
    integer :: b, k, p, corner
    call collect_points(mesh, points)
    allocate (told(points%n), source=.false.)
    do b = 1, size(mesh%side_element)
      side = make_side(mesh, b)
      call points_near(points, side, found)
      do k = 1, size(found)
        p = found(k)
        if (told(p) .or. points%side(p) == b .or. any(side%node == points%node(p))) cycle
        corner = corner_at(side, points%x(:, p))
        if (corner > 0) then
          told(p) = points%node(p) > side%node(corner) .or. (p > points%vertices .and. points%node(p) > 0) ! each pair once
          if (told(p)) call add_item(same, node_label(mesh, side%node(corner))//" and "//node_label(mesh, points%node(p)))
          cycle
        end if
        if (.not. lies_on(side, points%x(:, p))) cycle
        if (points%node(p) > 0) then
          told(p) = .true.
          call add_item(hanging, node_label(mesh, points%node(p))//" on "//element_label(mesh, mesh%side_element(b)))
        else if (.not. same_corners(side_nodes(mesh, mesh%side_element(points%side(p)), mesh%side_number(points%side(p))), side%node)) then
          told([p, points%vertices + b]) = .true.
          call add_item(covering, element_label(mesh, mesh%side_element(points%side(p)))//" and " &
            //element_label(mesh, mesh%side_element(b)))
        end if
      end do
    end do
    call tell_list(path, "different nodes at the same place", same, "merge them (preprocessing/convert_mesh.py does with --merge)", error)
    call tell_list(path, "hanging nodes (on a side of an element that does not have them)", hanging, &
      "split that element, or mesh both places with sides that match", error)
    if (same%n + hanging%n == 0) call tell_list(path, "boundary sides that cover each other", covering, & ! else they follow from that
      "neighbours must have all nodes of their common side in common, and as many: faces of tetrahedra do not fit those of hexahedra", error)
  end subroutine check_contacts

  !> Whether two sides have the same corners
  pure logical function same_corners(a, b)
    integer, intent(in) :: a(most_side_corners), b(most_side_corners)
    integer :: k
    same_corners = all([(any(b == a(k)), k=1, most_side_corners)])
  end function same_corners

end module gimp_mesh_conformity
