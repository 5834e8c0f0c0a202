!> Who neighbours whom in a mesh: elements around vertices, elements across sides, boundary sides and their groups
module gimp_mesh_connect
  use gimp_mesh, only: mesh_t, kind_corners, kind_sides, side_nodes, most_side_corners
  implicit none(type, external)
  private
  public :: connect_mesh, forget_connections, find_side

contains

  !> Fill in all connections of a mesh from its elements; nodes and elements keep their numbers from here on. Numbers of nodes must be in
  !> range (the reader sees to it). Of a side that more than two elements have, the first two are neighbours and the others end there
  !> (gimp_mesh_checks refuses it)
  pure subroutine connect_mesh(mesh)
    type(mesh_t), intent(inout) :: mesh
    call forget_connections(mesh)
    call list_vertex_elements(mesh)
    call pair_sides(mesh)
    call number_boundary(mesh)
    call group_sides(mesh)
  end subroutine connect_mesh

  !> What connect_mesh has made
  pure subroutine forget_connections(mesh)
    type(mesh_t), intent(inout) :: mesh
    if (.not. allocated(mesh%across)) return
    deallocate (mesh%vertex_first, mesh%vertex_element, mesh%across, mesh%side_element, mesh%side_number, mesh%side_group)
  end subroutine forget_connections

  !> Elements around each vertex: count, sum, fill
  pure subroutine list_vertex_elements(mesh)
    type(mesh_t), intent(inout) :: mesh
    integer, allocatable :: place(:)
    integer :: e, k, node
    allocate (mesh%vertex_first(mesh%nodes + 1), source=0)
    do e = 1, mesh%elements
      do k = 1, kind_corners(mesh%kind(e))
        node = mesh%node(k, e)
        mesh%vertex_first(node + 1) = mesh%vertex_first(node + 1) + 1
      end do
    end do
    mesh%vertex_first(1) = 1
    do node = 1, mesh%nodes
      mesh%vertex_first(node + 1) = mesh%vertex_first(node) + mesh%vertex_first(node + 1)
    end do
    allocate (mesh%vertex_element(mesh%vertex_first(mesh%nodes + 1) - 1))
    place = mesh%vertex_first
    do e = 1, mesh%elements
      do k = 1, kind_corners(mesh%kind(e))
        node = mesh%node(k, e)
        mesh%vertex_element(place(node)) = e
        place(node) = place(node) + 1
      end do
    end do
  end subroutine list_vertex_elements

  !> The element beyond each side, 0 where there is none. Each side is listed once, under the highest of its nodes, so that few stand in
  !> one list
  pure subroutine pair_sides(mesh)
    type(mesh_t), intent(inout) :: mesh
    integer, allocatable :: first(:), next(:), corner(:, :)
    integer :: e, s, most, side, other, owner, node
    most = maxval(kind_sides(mesh%kind))
    allocate (mesh%across(most, mesh%elements), source=0)
    allocate (first(mesh%nodes), source=0)
    allocate (next(most*mesh%elements), corner(most_side_corners, most*mesh%elements))
    do e = 1, mesh%elements
      do s = 1, kind_sides(mesh%kind(e))
        side = s + most*(e - 1)
        corner(:, side) = ascending(side_nodes(mesh, e, s))
        node = corner(most_side_corners, side)
        other = first(node)
        do while (other > 0)
          if (all(corner(:, other) == corner(:, side))) exit
          other = next(other)
        end do
        if (other == 0) then
          next(side) = first(node)
          first(node) = side
          cycle
        end if
        owner = 1 + (other - 1)/most
        if (mesh%across(other - most*(owner - 1), owner) /= 0) cycle ! two elements have it already
        mesh%across(other - most*(owner - 1), owner) = e
        mesh%across(s, e) = owner
      end do
    end do
  end subroutine pair_sides

  !> Number the sides without a neighbour
  pure subroutine number_boundary(mesh)
    type(mesh_t), intent(inout) :: mesh
    integer :: e, s, n
    n = 0
    do e = 1, mesh%elements
      n = n + count(mesh%across(:kind_sides(mesh%kind(e)), e) == 0)
    end do
    allocate (mesh%side_element(n), mesh%side_number(n))
    n = 0
    do e = 1, mesh%elements
      do s = 1, kind_sides(mesh%kind(e))
        if (mesh%across(s, e) /= 0) cycle
        n = n + 1
        mesh%across(s, e) = -n
        mesh%side_element(n) = e
        mesh%side_number(n) = s
      end do
    end do
  end subroutine number_boundary

  !> Groups of the boundary sides from the named sides; named ones that are no boundary sides are left out (gimp_mesh_checks refuses them)
  pure subroutine group_sides(mesh)
    type(mesh_t), intent(inout) :: mesh
    integer :: k, e, s
    allocate (mesh%side_group(size(mesh%side_element)), source=0)
    if (.not. allocated(mesh%named_side_node)) return
    do k = 1, size(mesh%named_side_group)
      call find_side(mesh, mesh%named_side_node(:, k), e, s)
      if (e == 0) cycle
      if (mesh%across(s, e) < 0) mesh%side_group(-mesh%across(s, e)) = mesh%named_side_group(k)
    end do
  end subroutine group_sides

  !> The first element that has a side with these corners (in any order, 0 beyond them), and which of its sides that is; 0 if none has.
  !> Needs the elements around vertices
  pure subroutine find_side(mesh, corner, element, side)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: corner(most_side_corners)
    integer, intent(out) :: element, side
    integer :: sought(most_side_corners), k, e, s
    sought = ascending(corner)
    element = 0
    side = 0
    if (sought(most_side_corners) == 0) return
    do k = mesh%vertex_first(sought(most_side_corners)), mesh%vertex_first(sought(most_side_corners) + 1) - 1
      e = mesh%vertex_element(k)
      do s = 1, kind_sides(mesh%kind(e))
        if (any(ascending(side_nodes(mesh, e, s)) /= sought)) cycle
        element = e
        side = s
        return
      end do
    end do
  end subroutine find_side

  !> The corners of a side in ascending order, zeros first
  pure function ascending(corner) result(sorted)
    integer, intent(in) :: corner(most_side_corners)
    integer :: sorted(most_side_corners)
    integer :: low(2), high(2)
    low = [min(corner(1), corner(2)), min(corner(3), corner(4))]
    high = [max(corner(1), corner(2)), max(corner(3), corner(4))]
    sorted(1) = minval(low)
    sorted(4) = maxval(high)
    sorted(2) = min(maxval(low), minval(high))
    sorted(3) = max(maxval(low), minval(high))
  end function ascending

end module gimp_mesh_connect
