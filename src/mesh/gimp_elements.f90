!> Elements of a mesh: shape functions, natural coordinates of a place, volume, height and how well they are shaped.
!>
!> Natural coordinates xi run over [-1, 1]^d in lines, quads and hexahedra; in triangles and tetrahedra they are the barycentric
!> coordinates of nodes 2, 3 (and 4). Order of nodes as in gimp_mesh. The map of the bilinear quad is inverted in closed form, those of
!> quadratic elements and hexahedra by Newton's method. Everything is relative to node 1, so that no digits are lost far from the origin.
!> Nothing here traps or hangs for a degenerate element or a place that is no number: the answer is "outside".
module gimp_elements
  use gimp_kinds, only: wp
  use gimp_mesh, only: line2, triangle3, triangle6, quad4, quad8, quad9, tetrahedron4, hexahedron8, kind_dim, kind_nodes
  implicit none(type, external)
  private
  public :: shape_values, shape_slopes, shape_gradients, natural_coordinates, beyond, far_outside
  public :: element_volume, element_height, smallest_jacobian, jacobian

  real(wp), parameter :: far_outside = 1.0e10_wp !! natural coordinates of a place that has none

  !> Nodes of quads (as many as the kind has) and hexahedra
  real(wp), parameter :: quad_node(2, 9) = reshape(real([-1, -1, 1, -1, 1, 1, -1, 1, 0, -1, 1, 0, 0, 1, -1, 0, 0, 0], wp), [2, 9])
  real(wp), parameter :: hexahedron_node(3, 8) = reshape(real([-1, -1, -1, 1, -1, -1, 1, 1, -1, -1, 1, -1, -1, -1, 1, 1, -1, 1, 1, 1, 1, &
    -1, 1, 1], wp), [3, 8])
  real(wp), parameter :: triangle_node(2, 6) = 0.5_wp*reshape(real([0, 0, 2, 0, 0, 2, 1, 0, 1, 1, 0, 1], wp), [2, 6])
  real(wp), parameter :: simpson(27) = real([1, 4, 1, 4, 16, 4, 1, 4, 1, 4, 16, 4, 16, 64, 16, 4, 16, 4, 1, 4, 1, 4, 16, 4, 1, 4, 1], wp)/27
  real(wp), parameter :: gauss = 1.0_wp/sqrt(3.0_wp)
  real(wp), parameter :: round_off = epsilon(1.0_wp)

contains

  !> Shape functions N at xi
  pure subroutine shape_values(kind, xi, n)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xi(:) !! (dim)
    real(wp), intent(out) :: n(:) !! (nodes)
    real(wp) :: a(3), q(2)
    integer :: i
    select case (kind)
    case (line2)
      n(1:2) = 0.5_wp*[1.0_wp - xi(1), 1.0_wp + xi(1)]
    case (triangle3)
      n(1:3) = [1.0_wp - xi(1) - xi(2), xi(1), xi(2)]
    case (tetrahedron4)
      n(1:4) = [1.0_wp - xi(1) - xi(2) - xi(3), xi(1), xi(2), xi(3)]
    case (triangle6)
      a = [1.0_wp - xi(1) - xi(2), xi(1), xi(2)]
      n(1:3) = a*(2*a - 1.0_wp)
      n(4:6) = 4*a*a([2, 3, 1])
    case (quad4)
      do i = 1, 4
        n(i) = 0.25_wp*(1.0_wp + quad_node(1, i)*xi(1))*(1.0_wp + quad_node(2, i)*xi(2))
      end do
    case (quad8)
      do i = 1, 4
        q = quad_node(:, i)*xi(1:2)
        n(i) = 0.25_wp*(1.0_wp + q(1))*(1.0_wp + q(2))*(q(1) + q(2) - 1.0_wp)
      end do
      n(5:7:2) = 0.5_wp*(1.0_wp - xi(1)**2)*(1.0_wp + quad_node(2, 5:7:2)*xi(2))
      n(6:8:2) = 0.5_wp*(1.0_wp - xi(2)**2)*(1.0_wp + quad_node(1, 6:8:2)*xi(1))
    case (quad9)
      do i = 1, 9
        n(i) = parabola(quad_node(1, i), xi(1))*parabola(quad_node(2, i), xi(2))
      end do
    case (hexahedron8)
      do i = 1, 8
        n(i) = 0.125_wp*(1.0_wp + hexahedron_node(1, i)*xi(1))*(1.0_wp + hexahedron_node(2, i)*xi(2))*(1.0_wp + hexahedron_node(3, i)*xi(3))
      end do
    end select
  end subroutine shape_values

  !> Slopes dN/dxi at xi
  pure subroutine shape_slopes(kind, xi, dn)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xi(:) !! (dim)
    real(wp), intent(out) :: dn(:, :) !! (dim, nodes)
    real(wp) :: a(3), f(3), q(2)
    integer :: i
    select case (kind)
    case (line2)
      dn(1, 1:2) = [-0.5_wp, 0.5_wp]
    case (triangle3, tetrahedron4)
      call simplex_slopes(kind_dim(kind), dn)
    case (triangle6)
      a = [1.0_wp - xi(1) - xi(2), xi(1), xi(2)]
      call simplex_slopes(2, dn(:, 1:3)) ! of the barycentric coordinates
      do i = 1, 2
        dn(i, 4:6) = 4*(dn(i, 1:3)*a([2, 3, 1]) + a*dn(i, [2, 3, 1]))
        dn(i, 1:3) = dn(i, 1:3)*(4*a - 1.0_wp)
      end do
    case (quad4)
      do i = 1, 4
        dn(1, i) = 0.25_wp*quad_node(1, i)*(1.0_wp + quad_node(2, i)*xi(2))
        dn(2, i) = 0.25_wp*quad_node(2, i)*(1.0_wp + quad_node(1, i)*xi(1))
      end do
    case (quad8)
      do i = 1, 4
        q = quad_node(:, i)*xi(1:2)
        dn(1, i) = 0.25_wp*quad_node(1, i)*(1.0_wp + q(2))*(2*q(1) + q(2))
        dn(2, i) = 0.25_wp*quad_node(2, i)*(1.0_wp + q(1))*(q(1) + 2*q(2))
      end do
      dn(1, 5:7:2) = -xi(1)*(1.0_wp + quad_node(2, 5:7:2)*xi(2))
      dn(2, 5:7:2) = 0.5_wp*quad_node(2, 5:7:2)*(1.0_wp - xi(1)**2)
      dn(1, 6:8:2) = 0.5_wp*quad_node(1, 6:8:2)*(1.0_wp - xi(2)**2)
      dn(2, 6:8:2) = -xi(2)*(1.0_wp + quad_node(1, 6:8:2)*xi(1))
    case (quad9)
      do i = 1, 9
        dn(1, i) = parabola_slope(quad_node(1, i), xi(1))*parabola(quad_node(2, i), xi(2))
        dn(2, i) = parabola(quad_node(1, i), xi(1))*parabola_slope(quad_node(2, i), xi(2))
      end do
    case (hexahedron8)
      do i = 1, 8
        f = 1.0_wp + hexahedron_node(:, i)*xi(1:3)
        dn(1:3, i) = 0.125_wp*hexahedron_node(:, i)*f([2, 1, 1])*f([3, 3, 2])
      end do
    end select
  end subroutine shape_slopes

  !> Gradients grad N at xi [1/cells]; 0 where det J is
  pure subroutine shape_gradients(kind, xe, xi, g)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xe(:, :), xi(:) !! (dim, nodes), (dim)
    real(wp), intent(out) :: g(:, :) !! (dim, nodes)
    real(wp) :: j(kind_dim(kind), kind_dim(kind)), dn(kind_dim(kind), kind_nodes(kind)), det, per
    integer :: dim, i
    dim = kind_dim(kind)
    j = jacobian(kind, xe, xi)
    call shape_slopes(kind, xi, dn)
    det = determinant(j)
    per = 0.0_wp
    if (abs(det) > tiny(1.0_wp)/round_off**2) per = 1.0_wp/det
    select case (dim)
    case (1)
      g(1:1, 1:size(dn, 2)) = per*dn
    case (2)
      do i = 1, size(dn, 2)
        g(1:2, i) = per*(dn(1, i)*[j(2, 2), -j(1, 2)] + dn(2, i)*[-j(2, 1), j(1, 1)])
      end do
    case default
      do i = 1, size(dn, 2)
        g(1:3, i) = per*(dn(1, i)*normal(j(:, 2), j(:, 3)) + dn(2, i)*normal(j(:, 3), j(:, 1)) + dn(3, i)*normal(j(:, 1), j(:, 2)))
      end do
    end select
  end subroutine shape_gradients

  !> Slopes of barycentric coordinates
  pure subroutine simplex_slopes(dim, dn)
    integer, intent(in) :: dim
    real(wp), intent(out) :: dn(:, :)
    integer :: k
    dn(1:dim, 1:dim + 1) = 0.0_wp
    dn(1:dim, 1) = -1.0_wp
    do k = 1, dim
      dn(k, k + 1) = 1.0_wp
    end do
  end subroutine simplex_slopes

  !> The parabola through 1 at `node` and 0 at the other two of -1, 0, 1
  pure real(wp) function parabola(node, x)
    real(wp), intent(in) :: node, x
    parabola = merge(1.0_wp - x**2, 0.5_wp*x*(x + node), node == 0.0_wp)
  end function parabola

  !> Its slope
  pure real(wp) function parabola_slope(node, x)
    real(wp), intent(in) :: node, x
    parabola_slope = merge(-2*x, x + 0.5_wp*node, node == 0.0_wp)
  end function parabola_slope

  !> How far xi lies outside in natural coordinates: at most 0 inside, huge for what is no number
  pure real(wp) function beyond(kind, xi)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xi(:) !! (dim)
    integer :: dim
    dim = kind_dim(kind)
    select case (kind)
    case (triangle3, triangle6, tetrahedron4)
      beyond = -min(minval(xi(1:dim)), 1.0_wp - sum(xi(1:dim)))
    case default
      beyond = maxval(abs(xi(1:dim))) - 1.0_wp
    end select
    if (.not. all(abs(xi(1:dim)) <= far_outside)) beyond = far_outside
  end function beyond

  !> Natural coordinates of a place, also of one up to half an element outside, for callers who extrapolate.
  !> Where there are none (certainly outside, a degenerate or flipped element, no number) ok is false and xi far outside.
  pure subroutine natural_coordinates(kind, xe, x, xi, ok)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xe(:, :), x(:) !! (dim, nodes), (dim) places of the nodes and the place sought
    real(wp), intent(out) :: xi(:) !! (dim)
    logical, intent(out) :: ok
    integer :: dim
    dim = kind_dim(kind)
    select case (kind)
    case (line2)
      ok = xe(1, 2) - xe(1, 1) > 0.0_wp
      if (ok) xi(1) = 2*((x(1) - xe(1, 1))/(xe(1, 2) - xe(1, 1))) - 1.0_wp
    case (triangle3)
      call in_triangle(xe, x, xi, ok)
    case (tetrahedron4)
      call in_tetrahedron(xe, x, xi, ok)
    case (quad4)
      call in_quad(xe, x, xi, ok)
    case default
      call in_curved(kind, xe, x, xi, ok)
    end select
    if (ok) ok = all(abs(xi(1:dim)) < far_outside)
    if (.not. ok) xi(1:dim) = far_outside
  end subroutine natural_coordinates

  !> Triangle: x - x1 = (x2 - x1) xi1 + (x3 - x1) xi2
  pure subroutine in_triangle(xe, x, xi, ok)
    real(wp), intent(in) :: xe(:, :), x(:)
    real(wp), intent(out) :: xi(:)
    logical, intent(out) :: ok
    real(wp) :: a(2), b(2), r(2), det
    a = xe(1:2, 2) - xe(1:2, 1)
    b = xe(1:2, 3) - xe(1:2, 1)
    r = x(1:2) - xe(1:2, 1)
    det = cross(a, b)
    ok = det > round_off**2*(sum(a**2) + sum(b**2))
    if (ok) xi(1:2) = [cross(r, b), cross(a, r)]/det
  end subroutine in_triangle

  !> Tetrahedron: the same in three dimensions
  pure subroutine in_tetrahedron(xe, x, xi, ok)
    real(wp), intent(in) :: xe(:, :), x(:)
    real(wp), intent(out) :: xi(:)
    logical, intent(out) :: ok
    real(wp) :: e(3, 3), r(3), det
    integer :: k
    do k = 1, 3
      e(:, k) = xe(1:3, k + 1) - xe(1:3, 1)
    end do
    r = x(1:3) - xe(1:3, 1)
    det = determinant(e)
    ok = det > round_off**2*sum(e**2)**1.5_wp
    if (ok) xi(1:3) = [dot_product(r, normal(e(:, 2), e(:, 3))), dot_product(r, normal(e(:, 3), e(:, 1))), &
      dot_product(r, normal(e(:, 1), e(:, 2)))]/det
  end subroutine in_tetrahedron

  !> Bilinear quad in closed form, valid for parallelograms, trapezoids and collapsed edges alike.
  !>
  !> With s, t in [0, 1], x - x1 = a s + b t + c s t. Eliminating s or t leaves a quadratic for the other, A t^2 + B t + C = 0. Its slope at a
  !> root, 2 A t + B = +-sqrt(D), is det J there, and so is that of the other quadratic: both have the same D, and the root sought
  !> is the one with the positive sign. The form of the root is chosen by the sign of B so that nothing cancels.
  pure subroutine in_quad(xe, x, xi, ok)
    real(wp), intent(in) :: xe(:, :), x(:)
    real(wp), intent(out) :: xi(:)
    logical, intent(out) :: ok
    real(wp) :: a(2), b(2), c(2), r(2), ab, rc, a2, b2, c2, d, jacobian
    a = xe(1:2, 2) - xe(1:2, 1)
    b = xe(1:2, 4) - xe(1:2, 1)
    c = (xe(1:2, 3) - xe(1:2, 2)) - b
    r = x(1:2) - xe(1:2, 1)
    ab = cross(a, b)
    rc = cross(r, c)
    a2 = cross(c, b)
    b2 = ab + rc
    c2 = cross(r, a)
    d = b2**2 - 4*a2*c2
    ok = cross(a + b + c, b - a) > 0.0_wp & ! diagonals: the element has an area
      .and. d >= -64*round_off*(b2**2 + abs(4*a2*c2)) ! where det J = 0, d may miss 0 by round-off
    if (.not. ok) return
    jacobian = sqrt(max(d, 0.0_wp))
    xi(1) = 2*root(cross(a, c), ab - rc, -cross(r, b), jacobian) - 1.0_wp
    xi(2) = 2*root(a2, b2, c2, jacobian) - 1.0_wp
  end subroutine in_quad

  !> The root t of A t^2 + B t + C = 0 with 2 A t + B = s
  pure real(wp) function root(a, b, c, s)
    real(wp), intent(in) :: a, b, c, s !! s = sqrt(B^2 - 4 A C)
    real(wp) :: above, below
    above = merge(-2*c, s - b, b >= 0.0_wp)
    below = merge(b + s, 2*a, b >= 0.0_wp)
    root = min(abs(above)/max(abs(below), tiny(1.0_wp)/round_off), far_outside)*sign(1.0_wp, above)*sign(1.0_wp, below)
  end function root

  !> Quadratic elements and hexahedra: Newton's method from the centre, and from the nodes, and places before them, if that does not end inside.
  !> Of several solutions (the map may fold outside of the element) the one closest to the element counts.
  pure subroutine in_curved(kind, xe, x, xi, ok)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xe(:, :), x(:)
    real(wp), intent(out) :: xi(:)
    logical, intent(out) :: ok
    real(wp) :: trial(kind_dim(kind)), middle(kind_dim(kind)), low(kind_dim(kind)), high(kind_dim(kind)), over, least
    integer :: start, dim, n
    logical :: found, in_box
    dim = kind_dim(kind)
    n = kind_nodes(kind)
    low = minval(xe(1:dim, 1:n), dim=2)
    high = maxval(xe(1:dim, 1:n), dim=2)
    if (kind /= hexahedron8) then ! sides bulge: a parabola through three points leaves their box, at most by its size
      middle = high - low
      low = low - middle
      high = high + middle
    end if
    in_box = all(x(1:dim) >= low .and. x(1:dim) <= high)
    middle = merge(1.0_wp/3.0_wp, 0.0_wp, kind == triangle6)
    least = far_outside
    do start = 0, 2*n
      trial = middle
      if (start > 0) trial = middle + merge(1.0_wp, 0.7_wp, start <= n)*(node_place(kind, 1 + modulo(start - 1, n)) - middle)
      call newton(kind, xe, x, middle, trial, found)
      if (.not. found) cycle
      over = beyond(kind, trial)
      if (over < least) then
        least = over
        xi(1:dim) = trial
      end if
      if (least <= 0.0_wp .or. .not. in_box .or. (start >= n .and. least < far_outside)) exit
    end do
    ok = least < far_outside
  end subroutine in_curved

  !> Natural coordinates of a node
  pure function node_place(kind, node) result(xi)
    integer, intent(in) :: kind, node
    real(wp) :: xi(kind_dim(kind))
    select case (kind)
    case (hexahedron8)
      xi = hexahedron_node(:, node)
    case (triangle6)
      xi = triangle_node(:, node)
    case default
      xi = quad_node(:, node)
    end select
  end function node_place

  !> Newton's method for X(xi) = x with steps that are cut at the size of an element and halved until the distance shrinks
  pure subroutine newton(kind, xe, x, middle, xi, found)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xe(:, :), x(:), middle(:) !! middle: natural coordinates of the centre
    real(wp), intent(inout) :: xi(:) !! start, then solution
    logical, intent(out) :: found
    integer, parameter :: most_steps = 50, most_cuts = 6
    real(wp), parameter :: farthest = 3.0_wp !! natural coordinates beyond which nobody extrapolates
    real(wp) :: r(kind_dim(kind)), r_new(kind_dim(kind)), step(kind_dim(kind)), at(kind_dim(kind))
    real(wp) :: j(kind_dim(kind), kind_dim(kind)), det, longest
    integer :: k, cut
    found = .false.
    r = rest(xi)
    do k = 1, most_steps
      j = jacobian(kind, xe, xi)
      det = determinant(j)
      if (.not. det > tiny(1.0_wp)/round_off**2) return ! folded, degenerate or no number
      step = solved(j, det, r)
      longest = maxval(abs(step))
      found = longest <= 0.1_wp*sqrt(round_off) ! the next step would be about the square of it
      if (.not. longest < far_outside) return
      step = step*min(1.0_wp, 1.0_wp/max(longest, round_off))
      do cut = 1, most_cuts
        at = min(max(xi + step, middle - farthest), middle + farthest)
        r_new = rest(at)
        if (found .or. sum(r_new**2) < sum(r**2)) exit
        step = 0.5_wp*step
      end do
      if (cut > most_cuts) then ! the distance may be as short as round-off lets it be
        found = maxval(abs(r)) <= 64*round_off*(maxval(xe(1, :)) - minval(xe(1, :)))
        return
      end if
      xi = at
      r = r_new
      if (found) return
    end do

  contains

    !> x - X(xi)
    pure function rest(xi)
      real(wp), intent(in) :: xi(:)
      real(wp) :: rest(size(xi)), n(kind_nodes(kind))
      integer :: i
      call shape_values(kind, xi, n)
      rest = x(1:size(xi)) - xe(1:size(xi), 1)
      do i = 2, size(n)
        rest = rest - n(i)*(xe(1:size(xi), i) - xe(1:size(xi), 1))
      end do
    end function rest

  end subroutine newton

  !> J_ij = dX_i/dxi_j at xi
  pure function jacobian(kind, xe, xi) result(j)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xe(:, :), xi(:) !! (dim, nodes), (dim)
    real(wp) :: j(kind_dim(kind), kind_dim(kind)), dn(kind_dim(kind), kind_nodes(kind))
    integer :: dim, i, k
    dim = kind_dim(kind)
    call shape_slopes(kind, xi, dn)
    j = 0.0_wp
    do i = 2, kind_nodes(kind)
      do k = 1, dim
        j(:, k) = j(:, k) + dn(k, i)*(xe(1:dim, i) - xe(1:dim, 1))
      end do
    end do
  end function jacobian

  !> Volume (area, length) by a rule that is exact for the kind; negative for a flipped element
  pure real(wp) function element_volume(kind, xe) result(volume)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xe(:, :) !! (dim, nodes)
    integer :: i
    select case (kind)
    case (line2)
      volume = 2*det_at(kind, xe, [0.0_wp])
    case (triangle3)
      volume = 0.5_wp*det_at(kind, xe, [0.0_wp, 0.0_wp])
    case (triangle6) ! det J has degree 2
      volume = (det_at(kind, xe, [0.5_wp, 0.0_wp]) + det_at(kind, xe, [0.5_wp, 0.5_wp]) + det_at(kind, xe, [0.0_wp, 0.5_wp]))/6
    case (quad4) ! linear
      volume = 4*det_at(kind, xe, [0.0_wp, 0.0_wp])
    case (tetrahedron4)
      volume = det_at(kind, xe, [0.0_wp, 0.0_wp, 0.0_wp])/6
    case (hexahedron8) ! degree 2 along each axis, for which Simpson's rule is exact
      volume = dot_product(simpson, reshape(hexahedron_lattice(xe), [27]))
    case default ! degree 3 along each axis
      volume = sum([(det_at(kind, xe, gauss*quad_node(:, i)), i=1, 4)])
    end select
  end function element_volume

  !> The least det J at a lattice of places, corners included, as a share of its mean: 1 for parallelograms and simplices, at most 0 for elements that
  !> fold, -1 for those without volume. The lattice tells det J of all kinds but quad8 and quad9 completely; those have 9 places an axis.
  pure real(wp) function smallest_jacobian(kind, xe) result(least)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xe(:, :) !! (dim, nodes)
    real(wp) :: mean, size_here
    integer :: i, j
    least = 1.0_wp
    mean = element_volume(kind, xe)
    size_here = maxval(maxval(xe, dim=2) - minval(xe, dim=2))
    if (.not. mean > 16*round_off*size_here**kind_dim(kind)) then ! round-off may leave some of nothing
      least = -1.0_wp
      return
    end if
    select case (kind)
    case (quad4)
      do i = 1, 4
        call look_at(4.0_wp, quad_node(:, i))
      end do
    case (quad8, quad9)
      do j = -4, 4
        do i = -4, 4
          call look_at(4.0_wp, 0.25_wp*[i, j])
        end do
      end do
    case (triangle6)
      do j = 0, 8
        do i = 0, 8 - j
          call look_at(0.5_wp, 0.125_wp*[i, j])
        end do
      end do
    case (hexahedron8)
      least = min(least, 8.0_wp*minval(hexahedron_lattice(xe))/mean)
    end select

  contains

    pure subroutine look_at(size, xi)
      real(wp), intent(in) :: size, xi(:) !! volume in natural coordinates, place
      least = min(least, size*det_at(kind, xe, xi)/mean)
    end subroutine look_at

  end function smallest_jacobian

  !> det J of a hexahedron at the 27 places with natural coordinates -1, 0, 1. Each column of J lies between the four edges along its axis
  pure function hexahedron_lattice(xe) result(det)
    real(wp), intent(in) :: xe(:, :) !! (3, 8)
    real(wp) :: det(3, 3, 3)
    real(wp) :: a(3, 3, 3), b(3, 3, 3), c(3, 3, 3) !! dX/dxi_1 at (xi_2, xi_3), dX/dxi_2 at (xi_1, xi_3), dX/dxi_3 at (xi_1, xi_2)
    integer :: i, j, k
    call spread_edges(xe(:, [2, 3, 6, 7]) - xe(:, [1, 4, 5, 8]), a)
    call spread_edges(xe(:, [4, 3, 8, 7]) - xe(:, [1, 2, 5, 6]), b)
    call spread_edges(xe(:, [5, 6, 8, 7]) - xe(:, [1, 2, 4, 3]), c)
    do k = 1, 3
      do j = 1, 3
        do i = 1, 3
          det(i, j, k) = dot_product(a(:, j, k), normal(b(:, i, k), c(:, i, j)))
        end do
      end do
    end do
  end function hexahedron_lattice

  !> dX along one axis from the four edges along it: at their places on the other two axes, in the middle between two, and in that of all
  pure subroutine spread_edges(edge, slope)
    real(wp), intent(in) :: edge(3, 4) !! low low, high low, low high, high high
    real(wp), intent(out) :: slope(3, 3, 3)
    slope(:, 1:3:2, 1) = 0.5_wp*edge(:, 1:2)
    slope(:, 1:3:2, 3) = 0.5_wp*edge(:, 3:4)
    slope(:, 2, 1:3:2) = 0.5_wp*(slope(:, 1, 1:3:2) + slope(:, 3, 1:3:2))
    slope(:, :, 2) = 0.5_wp*(slope(:, :, 1) + slope(:, :, 3))
  end subroutine spread_edges

  !> det J at xi
  pure real(wp) function det_at(kind, xe, xi)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xe(:, :), xi(:)
    det_at = determinant(jacobian(kind, xe, xi))
  end function det_at

  !> Smallest height [cells], never more than the way of a wave across the element: the edge of a square or cube. Quads and hexahedra: the
  !> heights of the parallelograms and parallelepipeds at their corners; quadratic elements: the heights of the four parts that
  !> their nodes divide them into. 0 for flipped elements.
  pure real(wp) function element_height(kind, xe) result(height)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xe(:, :) !! (dim, nodes)
    integer, parameter :: parts(3, 4) = reshape([1, 4, 6, 4, 2, 5, 6, 5, 3, 4, 5, 6], [3, 4])
    integer, parameter :: next(3, 8) = reshape([2, 4, 5, 3, 1, 6, 4, 2, 7, 1, 3, 8, 8, 6, 1, 5, 7, 2, 6, 8, 3, 7, 5, 4], [3, 8])
    real(wp) :: node(2, 9), n(8), e(3, 3)
    integer :: i, k
    height = huge(1.0_wp)
    select case (kind)
    case (line2)
      height = xe(1, 2) - xe(1, 1)
    case (triangle3)
      height = corner_height(xe, 1, 2, 3)
    case (triangle6)
      do i = 1, 4
        height = min(height, corner_height(xe, parts(1, i), parts(2, i), parts(3, i)))
      end do
    case (quad4)
      height = quad_height(xe, [1, 2, 3, 4])
    case (quad8, quad9)
      node(:, 1:8) = xe(1:2, 1:8)
      call shape_values(quad8, [0.0_wp, 0.0_wp], n)
      node(:, 9) = matmul(xe(1:2, 1:8), n)
      if (kind == quad9) node(:, 9) = xe(1:2, 9)
      height = min(quad_height(node, [1, 5, 9, 8]), quad_height(node, [5, 2, 6, 9]), quad_height(node, [9, 6, 3, 7]), &
        quad_height(node, [8, 9, 7, 4]))
    case (tetrahedron4)
      do k = 1, 3
        e(:, k) = xe(1:3, k + 1) - xe(1:3, 1)
      end do
      height = solid_height(e, norm2(normal(e(:, 2) - e(:, 1), e(:, 3) - e(:, 1))))
    case (hexahedron8)
      do i = 1, 8
        do k = 1, 3
          e(:, k) = xe(1:3, next(k, i)) - xe(1:3, i)
        end do
        height = min(height, solid_height(e, 0.0_wp))
      end do
    end select
    height = max(height, 0.0_wp)
  end function element_height

  !> The least height of the four parallelograms at the corners of a quad
  pure real(wp) function quad_height(xe, corner) result(height)
    real(wp), intent(in) :: xe(:, :)
    integer, intent(in) :: corner(4)
    real(wp) :: e(2, 4)
    integer :: i
    height = huge(1.0_wp)
    do i = 1, 4
      e(:, i) = xe(1:2, corner(1 + modulo(i, 4))) - xe(1:2, corner(i))
    end do
    do i = 1, 4
      height = min(height, over(cross(e(:, 1 + modulo(i + 2, 4)), e(:, i)), max(norm2(e(:, i)), norm2(e(:, 1 + modulo(i + 2, 4))))))
    end do
  end function quad_height

  !> The least height of a triangle
  pure real(wp) function corner_height(xe, i, j, k) result(height)
    real(wp), intent(in) :: xe(:, :)
    integer, intent(in) :: i, j, k
    real(wp) :: a(2), b(2)
    a = xe(1:2, j) - xe(1:2, i)
    b = xe(1:2, k) - xe(1:2, i)
    height = over(cross(a, b), max(norm2(a), norm2(b), norm2(b - a)))
  end function corner_height

  !> The least height of a parallelepiped (or of a tetrahedron with the fourth face given)
  pure real(wp) function solid_height(e, fourth) result(height)
    real(wp), intent(in) :: e(3, 3), fourth !! edges; twice the area of one more face
    height = over(determinant(e), max(norm2(normal(e(:, 1), e(:, 2))), norm2(normal(e(:, 2), e(:, 3))), norm2(normal(e(:, 3), e(:, 1))), &
      fourth))
  end function solid_height

  !> a/b, 0 where b is
  pure real(wp) function over(a, b)
    real(wp), intent(in) :: a, b
    over = 0.0_wp
    if (b > tiny(1.0_wp)) over = a/b
  end function over

  pure real(wp) function cross(a, b)
    real(wp), intent(in) :: a(2), b(2)
    cross = a(1)*b(2) - a(2)*b(1)
  end function cross

  pure function normal(a, b)
    real(wp), intent(in) :: a(3), b(3)
    real(wp) :: normal(3)
    normal = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
  end function normal

  !> Determinant of 1x1 to 3x3
  pure real(wp) function determinant(j)
    real(wp), intent(in) :: j(:, :)
    select case (size(j, 1))
    case (1)
      determinant = j(1, 1)
    case (2)
      determinant = cross(j(:, 1), j(:, 2))
    case default
      determinant = dot_product(j(:, 1), normal(j(:, 2), j(:, 3)))
    end select
  end function determinant

  !> The solution of J y = r in two and three dimensions
  pure function solved(j, det, r) result(y)
    real(wp), intent(in) :: j(:, :), det, r(:)
    real(wp) :: y(size(r))
    if (size(r) == 2) then
      y = [cross(r, j(:, 2)), cross(j(:, 1), r)]/det
    else
      y = [dot_product(r, normal(j(:, 2), j(:, 3))), dot_product(r, normal(j(:, 3), j(:, 1))), dot_product(r, normal(j(:, 1), j(:, 2)))]/det
    end if
  end function solved

end module gimp_elements
