!> Single elements for tests: the natural one, stretched, turned, shifted, its nodes moved at random
module gimp_made_elements
  use gimp_kinds, only: wp
  use gimp_common_kinds, only: pi
  use gimp_mesh, only: line2, triangle3, triangle6, quad4, quad8, quad9, tetrahedron4, hexahedron8, kind_dim, kind_nodes, kind_corners
  use gimp_elements, only: smallest_jacobian
  use gimp_made_meshes, only: random_t, random_number_of
  implicit none(type, external)
  private
  public :: natural_nodes, made_element, random_place

contains

  !> Natural coordinates of the nodes of a kind
  pure function natural_nodes(kind) result(xi)
    integer, intent(in) :: kind
    real(wp) :: xi(kind_dim(kind), kind_nodes(kind))
    integer :: i, n
    xi = 0.0_wp
    n = kind_corners(kind)
    select case (kind)
    case (line2)
      xi(1, :) = [-1.0_wp, 1.0_wp]
    case (triangle3, triangle6, tetrahedron4)
      do i = 1, kind_dim(kind)
        xi(i, i + 1) = 1.0_wp
      end do
    case (quad4, quad8, quad9)
      xi(:, 1:4) = reshape(real([-1, -1, 1, -1, 1, 1, -1, 1], wp), [2, 4])
    case (hexahedron8)
      xi = reshape(real([-1, -1, -1, 1, -1, -1, 1, 1, -1, -1, 1, -1, -1, -1, 1, 1, -1, 1, 1, 1, 1, -1, 1, 1], wp), [3, 8])
    end select
    if (kind == triangle6 .or. kind == quad8 .or. kind == quad9) xi(:, n + 1:2*n) = middles(xi(:, 1:n))
  end function natural_nodes

  !> Middles of the sides
  pure function middles(corner) result(x)
    real(wp), intent(in) :: corner(:, :)
    real(wp) :: x(size(corner, 1), size(corner, 2))
    x = 0.5_wp*(corner + cshift(corner, 1, dim=2))
  end function middles

  !> An element with sides of about 1, up to `reach` from the origin. Each coordinate of its corners is moved by up to `distortion`, middles of
  !> sides and centres by 0.4 of that; it is stretched by up to `stretch`, turned, and has smallest_jacobian >= least
  function made_element(kind, distortion, least, stretch, reach, random) result(xe)
    integer, intent(in) :: kind
    real(wp), intent(in) :: distortion, least, stretch, reach
    type(random_t), intent(inout) :: random
    real(wp) :: xe(kind_dim(kind), kind_nodes(kind)), turn(3, 3)
    integer :: dim, n, i, k
    dim = kind_dim(kind)
    n = kind_corners(kind)
    do
      xe = natural_nodes(kind)*merge(1.0_wp, 0.5_wp, any(kind == [triangle3, triangle6, tetrahedron4]))
      call shake(distortion, xe(:, 1:n))
      if (kind_nodes(kind) > n) then
        xe(:, n + 1:2*n) = middles(xe(:, 1:n))
        if (kind == quad9) xe(:, 9) = 0.5_wp*sum(xe(:, 5:8), dim=2) - 0.25_wp*sum(xe(:, 1:4), dim=2)
        call shake(0.4_wp*distortion, xe(:, n + 1:))
      end if
      if (smallest_jacobian(kind, xe) >= least) exit
    end do
    if (dim > 1) xe(2, :) = xe(2, :)*stretch**(2*random_number_of(random) - 1)
    turn = turned()
    if (dim > 1) xe = matmul(turn(1:dim, 1:dim), xe)
    do k = 1, dim
      xe(k, :) = xe(k, :) + reach*(2*random_number_of(random) - 1)
    end do

  contains

    subroutine shake(by, x)
      real(wp), intent(in) :: by
      real(wp), intent(inout) :: x(:, :)
      do i = 1, size(x, 2)
        do k = 1, dim
          x(k, i) = x(k, i) + by*(2*random_number_of(random) - 1)
        end do
      end do
    end subroutine shake

    !> A random rotation, about z in 2D
    function turned() result(r)
      real(wp) :: r(3, 3), a, c, s
      a = 2*pi*random_number_of(random)
      c = cos(a)
      s = sin(a)
      r = reshape([c, s, 0.0_wp, -s, c, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [3, 3])
      if (dim == 3) r = matmul(r, cshift(r, 1))
      if (dim == 3) r = matmul(r, cshift(r, 1, dim=2))
      if (r(1, 1)*(r(2, 2)*r(3, 3) - r(2, 3)*r(3, 2)) + r(1, 2)*(r(2, 3)*r(3, 1) - r(2, 1)*r(3, 3)) + &
          r(1, 3)*(r(2, 1)*r(3, 2) - r(2, 2)*r(3, 1)) < 0.0_wp) r(:, 3) = -r(:, 3)
    end function turned

  end function made_element

  !> Natural coordinates of a place inside, or up to `outside` (in natural coordinates) outside
  function random_place(kind, outside, random) result(xi)
    integer, intent(in) :: kind
    real(wp), intent(in) :: outside
    type(random_t), intent(inout) :: random
    real(wp) :: xi(kind_dim(kind))
    integer :: k
    do
      do k = 1, size(xi)
        xi(k) = (1.0_wp + outside)*(2*random_number_of(random) - 1)
      end do
      if (all(kind /= [triangle3, triangle6, tetrahedron4])) exit
      xi = 0.5_wp*(1.0_wp + 3*outside + xi) - outside ! (-outside, 1 + outside)
      if (sum(xi) <= 1.0_wp + outside) exit
    end do
  end function random_place

end module gimp_made_elements
