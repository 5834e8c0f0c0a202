!> What falls to each node of a boundary side of a mesh: int N dA of what is spread over the side evenly, and int N n dA, the
!> area that the side turns outward, of a pressure. Edges count per metre, the points that end a line as 1.
module gimp_side_shares
  use gimp_kinds, only: dp
  use gimp_mesh, only: mesh_t, side_nodes, side_corners, kind_corners, most_side_corners, quad8, quad9, triangle6
  implicit none(type, external)
  private
  public :: most_side_nodes, nodes_of_side, share_side

  integer, parameter :: most_side_nodes = most_side_corners !! of a face with four corners; edges have up to 3

contains

  !> Nodes of a boundary side: its corners, then the middle of an edge with three
  pure subroutine nodes_of_side(mesh, side, n, node)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: side !! boundary side
    integer, intent(out) :: n, node(most_side_nodes)
    integer :: e, kind
    e = mesh%side_element(side)
    kind = mesh%kind(e)
    n = side_corners(kind)
    node = side_nodes(mesh, e, mesh%side_number(side))
    if (kind /= triangle6 .and. kind /= quad8 .and. kind /= quad9) return
    n = n + 1
    node(n) = mesh%node(kind_corners(kind) + mesh%side_number(side), e)
  end subroutine nodes_of_side

  !> The nodes of a boundary side and their shares of it
  pure subroutine share_side(mesh, side, n, node, area, outward)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: side !! boundary side
    integer, intent(out) :: n, node(most_side_nodes)
    real(dp), intent(out) :: area(most_side_nodes) !! int N dA [cells^(dim - 1)]
    real(dp), intent(out) :: outward(3, most_side_nodes) !! int N n dA, n outward [cells^(dim - 1)]
    real(dp) :: x(3, most_side_nodes)
    integer :: k
    call nodes_of_side(mesh, side, n, node)
    x = 0.0_dp
    do k = 1, n
      x(:mesh%dim, k) = real(mesh%x(:, node(k)), dp)
    end do
    area = 0.0_dp
    outward = 0.0_dp
    select case (mesh%dim)
    case (1)
      area(1) = 1.0_dp
      outward(1, 1) = merge(-1.0_dp, 1.0_dp, mesh%side_number(side) == 1)
    case (2)
      if (n == 2) then
        call share_straight(x(:, :2), area(:2), outward(:, :2))
      else
        call share_curved(x(:, :3), area(:3), outward(:, :3))
      end if
    case default
      if (n == 3) then
        call share_triangle(x(:, :3), area(:3), outward(:, :3))
      else
        call share_bilinear(x, area, outward)
      end if
    end select
  end subroutine share_side

  !> An edge of two nodes: halves
  pure subroutine share_straight(x, area, outward)
    real(dp), intent(in) :: x(3, 2)
    real(dp), intent(out) :: area(2), outward(3, 2)
    integer :: k
    do k = 1, 2
      outward(:, k) = 0.5_dp*[x(2, 2) - x(2, 1), x(1, 1) - x(1, 2), 0.0_dp]
      area(k) = norm2(outward(:, k))
    end do
  end subroutine share_straight

  !> An edge of three nodes, the middle last: 1/6, 1/6 and 4/6 if it is straight and that node in its middle. Gauss's rule with three points
  !> is exact for `outward`, and for `area` of straight edges.
  pure subroutine share_curved(x, area, outward)
    real(dp), intent(in) :: x(3, 3)
    real(dp), intent(out) :: area(3), outward(3, 3)
    real(dp), parameter :: at(3) = [-sqrt(0.6_dp), 0.0_dp, sqrt(0.6_dp)], weight(3) = [5.0_dp, 8.0_dp, 5.0_dp]/9.0_dp
    real(dp) :: s, n(3), along(3), turned(3)
    integer :: q, k
    area = 0.0_dp
    outward = 0.0_dp
    do q = 1, 3
      s = at(q)
      n = [0.5_dp*s*(s - 1.0_dp), 0.5_dp*s*(s + 1.0_dp), 1.0_dp - s**2]
      along = 0.5_dp*(x(:, 2) - x(:, 1)) + s*((x(:, 1) - x(:, 3)) + (x(:, 2) - x(:, 3)))
      turned = weight(q)*[along(2), -along(1), 0.0_dp]
      do k = 1, 3
        area(k) = area(k) + n(k)*norm2(turned)
        outward(:, k) = outward(:, k) + n(k)*turned
      end do
    end do
  end subroutine share_curved

  !> A triangle: thirds
  pure subroutine share_triangle(x, area, outward)
    real(dp), intent(in) :: x(3, 3)
    real(dp), intent(out) :: area(3), outward(3, 3)
    integer :: k
    do k = 1, 3
      outward(:, k) = cross(x(:, 2) - x(:, 1), x(:, 3) - x(:, 1))/6.0_dp
      area(k) = norm2(outward(:, k))
    end do
  end subroutine share_triangle

  !> A bilinear face, 2 x 2 points of Gauss: exact for `outward`, and for `area` of plane faces
  pure subroutine share_bilinear(x, area, outward)
    real(dp), intent(in) :: x(3, 4)
    real(dp), intent(out) :: area(4), outward(3, 4)
    real(dp), parameter :: corner(2, 4) = reshape([-1, -1, 1, -1, 1, 1, -1, 1], [2, 4])
    real(dp) :: at(2), n(4), r(3), s(3), turned(3)
    integer :: q, k
    area = 0.0_dp
    outward = 0.0_dp
    do q = 1, 4
      at = corner(:, q)/sqrt(3.0_dp)
      n = 0.25_dp*(1.0_dp + at(1)*corner(1, :))*(1.0_dp + at(2)*corner(2, :))
      r = 0.25_dp*((1.0_dp - at(2))*(x(:, 2) - x(:, 1)) + (1.0_dp + at(2))*(x(:, 3) - x(:, 4)))
      s = 0.25_dp*((1.0_dp - at(1))*(x(:, 4) - x(:, 1)) + (1.0_dp + at(1))*(x(:, 3) - x(:, 2)))
      turned = cross(r, s)
      do k = 1, 4
        area(k) = area(k) + n(k)*norm2(turned)
        outward(:, k) = outward(:, k) + n(k)*turned
      end do
    end do
  end subroutine share_bilinear

  pure function cross(u, w) result(c)
    real(dp), intent(in) :: u(3), w(3)
    real(dp) :: c(3)
    c = [u(2)*w(3) - u(3)*w(2), u(3)*w(1) - u(1)*w(3), u(1)*w(2) - u(2)*w(1)]
  end function cross

end module gimp_side_shares
