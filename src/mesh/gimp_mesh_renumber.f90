!> Other numbers for the nodes and elements of a mesh
module gimp_mesh_renumber
  use gimp_mesh, only: mesh_t
  use gimp_mesh_connect, only: forget_connections
  implicit none(type, external)
  private
  public :: renumber_mesh

contains

  !> Give nodes and elements of a mesh other numbers; connections are forgotten (`connect_mesh` makes them anew)
  pure subroutine renumber_mesh(mesh, element_order, node_order)
    type(mesh_t), intent(inout) :: mesh
    integer, intent(in) :: element_order(:), node_order(:) !! (new number) the old one
    integer, allocatable :: number(:) !! (old node) the new one; 0 stays 0
    integer :: i, e, k
    call forget_connections(mesh)
    allocate (number(0:mesh%nodes))
    number(0) = 0
    do i = 1, mesh%nodes
      number(node_order(i)) = i
    end do
    mesh%x = mesh%x(:, node_order)
    mesh%node_in_file = mesh%node_in_file(node_order)
    mesh%kind = mesh%kind(element_order)
    mesh%element_in_file = mesh%element_in_file(element_order)
    if (allocated(mesh%element_group)) mesh%element_group = mesh%element_group(element_order)
    mesh%node = mesh%node(:, element_order)
    do e = 1, mesh%elements
      do k = 1, size(mesh%node, 1)
        mesh%node(k, e) = number(mesh%node(k, e))
      end do
    end do
    if (.not. allocated(mesh%named_side_node)) return
    do k = 1, size(mesh%named_side_node, 2)
      mesh%named_side_node(:, k) = number(mesh%named_side_node(:, k))
    end do
  end subroutine renumber_mesh

end module gimp_mesh_renumber
