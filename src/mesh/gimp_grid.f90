!> The Cartesian background grid: where its nodes, cells and blocks lie.
!>
!> Node i of an axis lies at lower + i*spacing, i = 0..cells inside the box; nodes outside (ghosts) are ordinary nodes.
!> A cell is half open, [i, i+1). With open-knot splines a node stores a function of the spline instead (see gimp_splines).
!> Blocks hold 64 nodes in every dimension: 4x4x4, 8x8 or 64.
module gimp_grid
  use gimp_kinds, only: wp, dp, i8
  implicit none(type, external)
  private
  public :: grid_t, make_grid, block_edge, nodes_per_block, block_key, keys_around, block_at_key, fields_per_node
  public :: node_mass, longest_axis, block_of_node, has_images, canonical_node, low_side_node, high_side_node, node_at_place

  integer, parameter :: nodes_per_block = 64
  integer, parameter :: fields_per_node = 8 !! one cache line: three components, mass, three components, energy
  integer, parameter :: node_mass = 4 !! field of the nodal mass
  integer, parameter :: longest_axis = 2**20 !! blocks along an axis that a key has room for

  !> Box and spacing
  type :: grid_t
    integer :: dim = 0
    real(dp) :: lower(3) = 0.0_dp !! corner of the box [m]
    real(dp) :: spacing = 1.0_dp !! edge of a cell [m]
    integer :: cells(3) = 1 !! cells of the box along each axis
    integer :: edge(3) = 1 !! nodes along the edges of a block
    logical :: periodic(3) = .false. !! axes that close on themselves
    logical :: mirror_low(3) = .false., mirror_high(3) = .false. !! planes of symmetry
    logical :: is_mesh = .false. !! an unstructured mesh: node k is (k, 0, 0), a slot holds the nodes 64 at + 1 to 64 at + 64, blocks are its
    !! patches, and positions refer to the corner of the box whatever the block (edge = 0)
    integer :: open_degree = 0 !! degree of an open-knot spline whose functions are the nodes; 0: nodes are what they seem
  end type grid_t

contains

  !> Edges of a block in nodes: 4x4x4 in 3D, 8x8x1 in 2D, 64x1x1 in 1D
  pure function block_edge(dim) result(edge)
    integer, intent(in) :: dim
    integer :: edge(3)
    edge = 1
    select case (dim)
    case (1); edge(1) = 64
    case (2); edge(1:2) = 8
    case (3); edge = 4
    end select
  end function block_edge

  !> A grid from its box; the box is a whole number of cells (checked by the scene)
  pure function make_grid(dim, lower, upper, spacing) result(grid)
    integer, intent(in) :: dim
    real(dp), intent(in) :: lower(:), upper(:) !! [m]
    real(dp), intent(in) :: spacing !! [m]
    type(grid_t) :: grid
    grid%dim = dim
    grid%lower(:dim) = lower(:dim)
    grid%spacing = spacing
    grid%cells(:dim) = nint((upper(:dim) - lower(:dim))/spacing)
    grid%edge = block_edge(dim)
  end function make_grid

  !> Key of a block: its coordinates interleaved bit by bit (Morton order), so that near blocks have near keys.
  !> 20 bits an axis; the two bits above them are left for a refinement level.
  pure integer(i8) function block_key(at) result(key)
    integer, intent(in) :: at(3) !! block coordinates, ghosts negative
    integer(i8) :: part
    integer :: k
    key = 0
    do k = 1, 3
      part = spread_bits(int(at(k) + longest_axis/2, i8))
      key = ior(key, shiftl(part, k - 1))
    end do
  end function block_key

  !> Coordinates of the block with this key
  pure function block_at_key(key) result(at)
    integer(i8), intent(in) :: key
    integer :: at(3)
    integer :: bit, k
    at = -longest_axis/2
    do bit = 0, 19
      do k = 1, 3
        if (btest(key, 3*bit + k - 1)) at(k) = at(k) + shiftl(1, bit)
      end do
    end do
  end function block_at_key

  !> Keys of a block and of all around it, numbered as by `neighbour`
  pure function keys_around(at) result(keys)
    integer, intent(in) :: at(3)
    integer(i8) :: keys(27)
    integer(i8) :: part(-1:1, 3)
    integer :: d, k, dx, dy, dz
    do k = 1, 3
      do d = -1, 1
        part(d, k) = shiftl(spread_bits(int(at(k) + d + longest_axis/2, i8)), k - 1)
      end do
    end do
    k = 0
    do dz = -1, 1
      do dy = -1, 1
        do dx = -1, 1
          k = k + 1
          keys(k) = ior(part(dx, 1), ior(part(dy, 2), part(dz, 3)))
        end do
      end do
    end do
  end function keys_around

  !> Coordinates of the block that a node lies in
  pure function block_of_node(grid, node) result(at)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: node(3)
    integer :: at(3)
    at = (node - modulo(node, grid%edge))/grid%edge
  end function block_of_node

  !> Coordinates of the node at place 1..64 of the block of nodes at `at`
  pure function node_at_place(grid, at, place) result(node)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(3), place
    integer :: node(3)
    if (grid%is_mesh) then
      node = [nodes_per_block*at(1) + place, 0, 0]
      return
    end if
    associate (e => grid%edge, k => place - 1)
      node = at*e + [modulo(k, e(1)), modulo(k/e(1), e(2)), k/(e(1)*e(2))]
    end associate
  end function node_at_place

  !> Whether some nodes stand for others: periodic or symmetric sides
  pure logical function has_images(grid)
    type(grid_t), intent(in) :: grid
    has_images = any(grid%periodic) .or. any(grid%mirror_low) .or. any(grid%mirror_high)
  end function has_images

  !> The node on the low side of the box: node 0, or the first function of an open-knot spline
  pure integer function low_side_node(grid)
    type(grid_t), intent(in) :: grid
    low_side_node = merge(-1, 0, grid%open_degree > 0)
  end function low_side_node

  !> The node on the high side of the box along axis k: the last one, or the last function of an open-knot spline
  pure integer function high_side_node(grid, k)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: k
    high_side_node = grid%cells(k)
    if (grid%open_degree > 0) high_side_node = grid%cells(k) + grid%open_degree - 2
  end function high_side_node

  !> The node that a node stands for, and the signs that vector components take on the way
  pure subroutine canonical_node(grid, node, target, sign)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: node(3)
    integer, intent(out) :: target(3)
    real(wp), intent(out) :: sign(3) !! -1 along the axis of a mirror that was crossed
    integer :: k
    target = node
    sign = 1.0_wp
    do k = 1, grid%dim
      if (grid%periodic(k)) then
        target(k) = modulo(node(k), grid%cells(k))
      else
        do ! a wide support between two near mirrors is reflected by both
          if (grid%mirror_low(k) .and. target(k) < 0) then
            target(k) = -target(k)
          else if (grid%mirror_high(k) .and. target(k) > grid%cells(k)) then
            target(k) = 2*grid%cells(k) - target(k)
          else
            exit
          end if
          sign(k) = -sign(k)
        end do
      end if
    end do
  end subroutine canonical_node

  !> Put two empty bits between the 20 lowest bits of a number
  pure integer(i8) function spread_bits(number) result(s)
    integer(i8), intent(in) :: number
    s = iand(number, int(z"FFFFF", i8))
    s = iand(ior(s, shiftl(s, 32)), int(z"1F00000000FFFF", i8))
    s = iand(ior(s, shiftl(s, 16)), int(z"1F0000FF0000FF", i8))
    s = iand(ior(s, shiftl(s, 8)), int(z"100F00F00F00F00F", i8))
    s = iand(ior(s, shiftl(s, 4)), int(z"10C30C30C30C30C3", i8))
    s = iand(ior(s, shiftl(s, 2)), int(z"1249249249249249", i8))
  end function spread_bits

end module gimp_grid
