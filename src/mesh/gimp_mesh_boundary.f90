!> The boundary sides of a mesh in space, and which points of the boundary lie on which side. For checks at the start of a run
module gimp_mesh_boundary
  use gimp_kinds, only: wp, i8
  use gimp_hash_table, only: hash_table_t, clear_table, insert_key, find_key
  use gimp_mesh, only: mesh_t, side_corners, side_nodes, middle_node, most_side_corners
  implicit none(type, external)
  private
  public :: side_t, points_t, make_side, collect_points, points_near, corner_at, lies_on

  real(wp), parameter :: touching = 0.1_wp*sqrt(sqrt(epsilon(1.0_wp))) !! places nearer to each other than this share of a side's size (1e-5)
  !! are the same: many files hold six digits

  !> A side as X(u, v) with 0 <= u, v <= 1 (u + v <= 1 for triangles): a point, line or parabola, flat triangle or bilinear quad
  type :: side_t
    integer :: dim = 0, corners = 0
    integer :: node(most_side_corners) = 0
    real(wp) :: x(3, most_side_corners) = 0.0_wp !! corners
    real(wp) :: low(3) = 0.0_wp, high(3) = 0.0_wp !! a box around it
    real(wp) :: size = 0.0_wp !! longest edge of the box; of the element in one dimension
    real(wp) :: by_u(3) = 0.0_wp, by_uu(3) = 0.0_wp, by_v(3) = 0.0_wp, by_uv(3) = 0.0_wp !! X = x1 + by_u u + by_uu u^2 + ..
  end type side_t

  !> Points of the boundary, sorted into cubes
  type :: points_t
    integer :: dim = 0, n = 0
    integer :: vertices = 0 !! they come first, then the middles of the boundary sides
    real(wp), allocatable :: x(:, :) !! (3, point)
    integer, allocatable :: node(:) !! (point) -1 for middles that are no nodes
    integer, allocatable :: side(:) !! (point) a boundary side that it belongs to
    real(wp) :: low(3) = 0.0_wp, edge = 1.0_wp !! corner of all cubes, and the edge of one
    integer :: cubes(3) = 1 !! along each axis
    type(hash_table_t) :: first !! the first point of a cube
    integer, allocatable :: next(:) !! the next one in the same cube; 0: no more
  end type points_t

contains

  !> Boundary side b
  pure function make_side(mesh, b) result(side)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: b
    type(side_t) :: side
    real(wp) :: control(3)
    integer :: e, s, k, middle
    e = mesh%side_element(b)
    s = mesh%side_number(b)
    side%dim = mesh%dim
    side%corners = side_corners(mesh%kind(e))
    side%node = side_nodes(mesh, e, s)
    do k = 1, side%corners
      side%x(:mesh%dim, k) = mesh%x(:, side%node(k))
    end do
    side%low = minval(side%x(:, :side%corners), 2)
    side%high = maxval(side%x(:, :side%corners), 2)
    select case (side%corners)
    case (2)
      side%by_u = side%x(:, 2) - side%x(:, 1)
      middle = middle_node(mesh, e, s)
      if (middle > 0) then
        control = 0.0_wp ! of the parabola as Bezier has it, which stays in the triangle of its ends and this point
        control(:2) = 2.0_wp*mesh%x(:2, middle) - 0.5_wp*(side%x(:2, 1) + side%x(:2, 2))
        side%by_u = 2.0_wp*(control - side%x(:, 1))
        side%by_uu = side%x(:, 1) - 2.0_wp*control + side%x(:, 2)
        side%low = min(side%low, control)
        side%high = max(side%high, control)
      end if
    case (3)
      side%by_u = side%x(:, 2) - side%x(:, 1)
      side%by_v = side%x(:, 3) - side%x(:, 1)
    case (4)
      side%by_u = side%x(:, 2) - side%x(:, 1)
      side%by_v = side%x(:, 4) - side%x(:, 1)
      side%by_uv = side%x(:, 1) - side%x(:, 2) + side%x(:, 3) - side%x(:, 4)
    end select
    side%size = maxval(side%high - side%low)
    if (side%corners == 1) side%size = abs(mesh%x(1, mesh%node(2, e)) - mesh%x(1, mesh%node(1, e)))
  end function make_side

  !> The place X(u, v) of a side, and its derivatives
  pure subroutine place_on(side, u, v, x, x_u, x_v)
    type(side_t), intent(in) :: side
    real(wp), intent(in) :: u, v
    real(wp), intent(out) :: x(3), x_u(3), x_v(3)
    x = side%x(:, 1) + u*(side%by_u + u*side%by_uu) + v*(side%by_v + u*side%by_uv)
    x_u = side%by_u + 2.0_wp*u*side%by_uu + v*side%by_uv
    x_v = side%by_v + u*side%by_uv
  end subroutine place_on

  !> The middle of a side: (1/2, 1/2), for triangles (1/3, 1/3)
  pure function middle_of(side) result(x)
    type(side_t), intent(in) :: side
    real(wp) :: x(3)
    real(wp) :: t, x_u(3), x_v(3)
    t = merge(1.0_wp/3.0_wp, 0.5_wp, side%corners == 3)
    call place_on(side, t, t, x, x_u, x_v)
  end function middle_of

  !> The corner of a side at a place, 0: none
  pure integer function corner_at(side, x)
    type(side_t), intent(in) :: side
    real(wp), intent(in) :: x(3)
    integer :: k
    corner_at = 0
    do k = 1, side%corners
      if (norm2(x - side%x(:, k)) <= touching*side%size) corner_at = k
    end do
  end function corner_at

  !> Whether a place lies on a side: the distance to it is made least by Gauss-Newton steps
  pure logical function lies_on(side, x)
    type(side_t), intent(in) :: side
    real(wp), intent(in) :: x(3)
    real(wp) :: u, v, at(3), x_u(3), x_v(3), uu, uv, vv, ru, rv, det
    integer :: step
    lies_on = .false.
    if (side%corners < 2) return
    u = 0.5_wp
    v = merge(0.5_wp, 0.0_wp, side%corners == 4)
    do step = 1, 8
      call place_on(side, u, v, at, x_u, x_v)
      uu = dot_product(x_u, x_u)
      ru = dot_product(x_u, x - at)
      if (side%corners == 2) then
        u = between(u + ru/max(uu, tiny(uu)))
        cycle
      end if
      uv = dot_product(x_u, x_v)
      vv = dot_product(x_v, x_v)
      rv = dot_product(x_v, x - at)
      det = max(uu*vv - uv**2, tiny(det))
      u = between(u + (ru*vv - rv*uv)/det)
      v = between(v + (rv*uu - ru*uv)/det)
    end do
    call place_on(side, u, v, at, x_u, x_v)
    if (norm2(x - at) > touching*side%size) return
    lies_on = min(u, v) >= -touching .and. max(u, v) <= 1.0_wp + touching
    if (side%corners == 3) lies_on = lies_on .and. u + v <= 1.0_wp + touching
  end function lies_on

  !> Steps stay near the side
  pure real(wp) function between(u)
    real(wp), intent(in) :: u
    between = max(-1.0_wp, min(2.0_wp, u))
  end function between

  !> All vertices and all middles of sides on the boundary
  subroutine collect_points(mesh, points)
    type(mesh_t), intent(in) :: mesh
    type(points_t), intent(out) :: points
    type(side_t) :: side
    logical, allocatable :: listed(:)
    real(wp) :: size_sum
    integer :: b, k, n, sides
    sides = size(mesh%side_element)
    points%dim = mesh%dim
    n = sides*(1 + merge(most_side_corners, 2, mesh%dim == 3))
    allocate (points%x(3, n), points%node(n), points%side(n), listed(mesh%nodes))
    listed = .false.
    size_sum = 0.0_wp
    n = 0
    do b = 1, sides
      side = make_side(mesh, b)
      size_sum = size_sum + side%size**mesh%dim
      do k = 1, side%corners
        if (listed(side%node(k))) cycle
        listed(side%node(k)) = .true.
        n = n + 1
        points%x(:, n) = side%x(:, k)
        points%node(n) = side%node(k)
        points%side(n) = b
      end do
    end do
    points%vertices = n
    do b = 1, sides
      points%x(:, n + b) = middle_of(make_side(mesh, b))
      points%node(n + b) = middle_node(mesh, mesh%side_element(b), mesh%side_number(b))
      if (points%node(n + b) == 0) points%node(n + b) = -1
      points%side(n + b) = b
    end do
    points%n = n + sides
    call sort_points(points, (size_sum/max(1, sides))**(1.0_wp/mesh%dim)) ! a few cubes to a side in the mean
  end subroutine collect_points

  !> Sort points into cubes, which should be such that all sides together reach into few
  subroutine sort_points(points, edge)
    type(points_t), intent(inout) :: points
    real(wp), intent(in) :: edge
    integer, parameter :: most = 2**20 !! cubes along an axis, so that keys have room
    integer, allocatable :: last(:) !! (first point of a cube) the last one so far
    integer(i8) :: key
    integer :: p, head
    if (points%n == 0) return
    points%low = minval(points%x(:, :points%n), 2)
    points%edge = max(edge, maxval(maxval(points%x(:, :points%n), 2) - points%low)/(most - 1))
    points%cubes = 1 + int((maxval(points%x(:, :points%n), 2) - points%low)/points%edge)
    call clear_table(points%first, points%n)
    allocate (points%next(points%n), last(points%n), source=0)
    do p = 1, points%n
      key = key_of_cube(points, int((points%x(:, p) - points%low)/points%edge))
      call insert_key(points%first, key, p, head)
      if (head < p) points%next(last(head)) = p
      last(head) = p
    end do
  end subroutine sort_points

  pure integer(i8) function key_of_cube(points, cube) result(key)
    type(points_t), intent(in) :: points
    integer, intent(in) :: cube(3) !! from 0
    key = cube(1) + int(points%cubes(1), i8)*(cube(2) + int(points%cubes(2), i8)*cube(3))
  end function key_of_cube

  !> The points in the box around a side
  pure subroutine points_near(points, side, found)
    type(points_t), intent(in) :: points
    type(side_t), intent(in) :: side
    integer, allocatable, intent(inout) :: found(:)
    integer :: from(3), to(3), i, j, k, p
    real(wp) :: low(3), high(3)
    low = side%low - touching*side%size
    high = side%high + touching*side%size
    from = max(0, min(points%cubes - 1, int((max(low, points%low) - points%low)/points%edge)))
    to = max(0, min(points%cubes - 1, int((max(high, points%low) - points%low)/points%edge)))
    found = [integer ::]
    do k = from(3), to(3)
      do j = from(2), to(2)
        do i = from(1), to(1)
          p = find_key(points%first, key_of_cube(points, [i, j, k]))
          do while (p > 0)
            if (all(points%x(:, p) >= low .and. points%x(:, p) <= high)) found = [found, p]
            p = points%next(p)
          end do
        end do
      end do
    end do
  end subroutine points_near

end module gimp_mesh_boundary
