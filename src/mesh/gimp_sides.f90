!> Sides of elements of a mesh: on which side of them a point is, who owns a point near them, and the nearest point of a boundary side.
!>
!> Who owns a point. Every side has a function that is positive within the element, zero on the side and a distance near it [cells]. It is
!> evaluated once for both elements that share the side, with the side turned the way that the numbers of its nodes say, so that both see
!> the same number but for its sign. The owner of a point is
!>   1. the element with the smallest number among those for which no function is negative; on a boundary side zero counts as inside;
!>   2. where rounding leaves none (three sides that meet at a vertex know nothing of each other), the element whose smallest function is
!>      largest, the smaller number if two are equal, provided that it is not below -`slack`.
!> This is a statement about the point alone, so it gives one owner whatever the order of search. Elements that can compete for a point share
!> a vertex near it; `owner_near` compares those around that vertex. A point for which all functions of an element exceed `slack` is far
!> from rounding and needs no comparison. Points that lie outside of the mesh by less than `slack` belong to the element there.
!>
!> Edges of quadratic elements are the parabolas through their three nodes, prolonged by their chords. Quadrilateral faces are folded by both
!> neighbours along the diagonal through the lowest node number: within are, for the element that sees a valley, the points above both
!> triangles, and for the other, that sees a ridge, those above either; the functions are minimum and maximum, opposite numbers.
module gimp_sides
  use gimp_kinds, only: wp
  use gimp_mesh, only: mesh_t, triangle6, quad8, quad9, kind_corners, kind_sides, side_of_kind, side_nodes, side_corners, &
    most_side_corners
  implicit none(type, external)
  private
  public :: slack, most_sides, side_value, side_values, side_plane, ends_at_both, owner_near, onto_side

  real(wp), parameter :: slack = max(1.0e-10_wp, 64.0_wp*epsilon(1.0_wp)) !! [cells] beyond all rounding, below all that matters
  integer, parameter :: most_sides = 6 !! of an element
  real(wp), parameter :: near = 1.0e4_wp*slack !! [cells] closer to a second side than this, a point may concern more than two elements

contains

  !> The function of side s of element e at x: positive within, near the side the distance from it [cells]
  pure real(wp) function side_value(mesh, e, s, x) result(value)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e, s
    real(wp), intent(in) :: x(mesh%dim) !! [cells]
    integer :: node(most_side_corners), a, b, middle
    select case (mesh%dim)
    case (1)
      a = mesh%node(s, e)
      b = mesh%node(3 - s, e)
      value = sign(1.0_wp, mesh%x(1, b) - mesh%x(1, a))*(x(1) - mesh%x(1, a))
    case (2)
      a = mesh%node(s, e)
      b = mesh%node(1 + modulo(s, kind_corners(mesh%kind(e))), e)
      middle = middle_node(mesh, e, s)
      if (middle > 0) then
        value = curve_distance(mesh%x(1:2, min(a, b)), mesh%x(1:2, max(a, b)), mesh%x(1:2, middle), x)
      else
        value = line_distance(mesh%x(1:2, min(a, b)), mesh%x(1:2, max(a, b)), x)
      end if
      if (a > b) value = -value
    case default
      node = side_nodes(mesh, e, s)
      if (side_corners(mesh%kind(e)) == 3) then
        value = -face_distance(mesh%x, node(:3), x) ! faces are seen from outside
      else
        value = -fold_distance(mesh%x, node, x)
      end if
    end select
  end function side_value

  !> The functions of all sides of element e at x [cells]; those it does not have are set to a huge number
  pure subroutine side_values(mesh, e, x, value)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp), intent(in) :: x(mesh%dim) !! [cells]
    real(wp), intent(out) :: value(most_sides)
    integer :: s
    value = huge(1.0_wp)
    do s = 1, kind_sides(mesh%kind(e))
      value(s) = side_value(mesh, e, s, x)
    end do
  end subroutine side_values

  !> The owner of a point that is on or close to sides of element e: none of the functions of e there may be below -`slack`
  pure subroutine owner_near(mesh, e, x, value, owner, tested)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp), intent(in) :: x(mesh%dim) !! [cells]
    real(wp), intent(in) :: value(most_sides) !! functions of e at x
    integer, intent(out) :: owner
    integer, intent(out) :: tested !! elements other than e that were looked at
    real(wp) :: of_other(most_sides), worst, best
    integer :: s, vertex, first, last, k, other
    ! competitors: all elements around the nearest vertex or, far from all vertices, the one across the side
    s = minloc(value, dim=1)
    vertex = 0
    first = 0
    last = 1
    if (count(value <= near) > 1) then
      vertex = vertex_near(mesh, e, x, value)
      first = mesh%vertex_first(vertex)
      last = mesh%vertex_first(vertex + 1) - 1
    end if
    owner = 0
    best = -huge(1.0_wp)
    tested = -1 ! e itself is among them
    do k = first, last
      if (vertex > 0) then
        other = mesh%vertex_element(k)
      else
        other = merge(e, mesh%across(s, e), k == 0)
        if (other < 0) exit
      end if
      tested = tested + 1
      call side_values(mesh, other, x, of_other) ! the only place where the sign of tiny numbers decides
      worst = minval(of_other)
      if (worst >= 0.0_wp) worst = huge(1.0_wp) ! all that contain the point are as good, the smallest number wins
      if (worst > best .or. (worst >= best .and. other < owner)) then
        best = worst
        owner = other
      end if
    end do
  end subroutine owner_near

  !> The corner of element e that most of the sides close to x share; the nearest of these
  pure integer function vertex_near(mesh, e, x, value) result(vertex)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp), intent(in) :: x(mesh%dim), value(most_sides)
    integer :: sides(8), corner(most_side_corners), k, s, best
    real(wp) :: distance, nearest
    sides = 0
    do s = 1, kind_sides(mesh%kind(e))
      if (value(s) > near) cycle
      corner = side_of_kind(mesh%kind(e), s)
      do k = 1, side_corners(mesh%kind(e))
        sides(corner(k)) = sides(corner(k)) + 1
      end do
    end do
    best = maxval(sides)
    nearest = huge(1.0_wp)
    vertex = mesh%node(1, e)
    do k = 1, kind_corners(mesh%kind(e))
      if (sides(k) < best) cycle
      distance = sum((mesh%x(:, mesh%node(k, e)) - x)**2)
      if (distance >= nearest) cycle
      nearest = distance
      vertex = mesh%node(k, e)
    end do
  end function vertex_near

  !> What planes say about a side: the function of part 1 or 2 of it (the triangles of a folded face; others have one part) is above `slack`
  !> where n.x > inner, n being a unit vector into element e, and below -`slack` where n.x < outer
  pure subroutine side_plane(mesh, e, s, part, n, inner, outer)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e, s, part
    real(wp), intent(out) :: n(mesh%dim), inner, outer
    integer :: node(most_side_corners), middle, triangle(3, 2)
    real(wp) :: margin, bulge
    logical :: turned, valley
    node = side_nodes(mesh, e, s)
    bulge = 0.0_wp
    select case (mesh%dim)
    case (1)
      n = sign(1.0_wp, mesh%x(1, mesh%node(3 - s, e)) - mesh%x(1, node(1)))
    case (2)
      n(1) = mesh%x(2, node(1)) - mesh%x(2, node(2))
      n(2) = mesh%x(1, node(2)) - mesh%x(1, node(1))
      n = n/norm2(n)
      middle = middle_node(mesh, e, s)
      if (middle > 0) bulge = dot_product(n, mesh%x(:, middle) - 0.5_wp*(mesh%x(:, node(1)) + mesh%x(:, node(2))))
    case default
      turned = .false.
      if (side_corners(mesh%kind(e)) == 4) then
        call see_fold(mesh%x, node, triangle, turned, valley)
        node(:3) = triangle(:, part)
      end if
      n = cross(mesh%x(:, node(3)) - mesh%x(:, node(1)), mesh%x(:, node(2)) - mesh%x(:, node(1)))
      n = n/norm2(n)
      if (turned) n = -n
    end select
    margin = 2.0_wp*slack + 8.0_wp*epsilon(1.0_wp)*maxval(abs(mesh%x(:, node(1))))
    inner = dot_product(n, mesh%x(:, node(1))) + max(bulge, 0.0_wp) + margin
    outer = dot_product(n, mesh%x(:, node(1))) + min(bulge, 0.0_wp) - margin
  end subroutine side_plane

  !> Does element e end at a folded face where both triangles are passed (a ridge seen from within), or where one is?
  pure logical function ends_at_both(mesh, e, s)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e, s
    integer :: triangle(3, 2)
    logical :: turned, valley
    ends_at_both = .false.
    if (side_corners(mesh%kind(e)) < 4) return
    call see_fold(mesh%x, side_nodes(mesh, e, s), triangle, turned, valley)
    ends_at_both = valley .neqv. turned
  end function ends_at_both

  !> The node in the middle of an edge that is curved; 0 for straight ones
  pure integer function middle_node(mesh, e, s) result(middle)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e, s
    middle = 0
    select case (mesh%kind(e))
    case (triangle6, quad8, quad9)
      middle = mesh%node(kind_corners(mesh%kind(e)) + s, e)
    end select
  end function middle_node

  !> Distance of p from the line through a and b, positive on its left [cells]
  pure real(wp) function line_distance(a, b, p) result(distance)
    real(wp), intent(in) :: a(2), b(2), p(2)
    distance = ((b(1) - a(1))*(p(2) - a(2)) - (b(2) - a(2))*(p(1) - a(1)))/norm2(b - a)
  end function line_distance

  !> Height of p over the curve from a over `middle` to b of a quadratic edge, across its chord, positive on the left [cells]; over the chord
  !> where p is not beside it. With the middle parted from that of the chord by (d_t, d_n) along and across it, the curve is
  !> t = xi L/2 + (1 - xi^2) d_t, n = (1 - xi^2) d_n, and xi is the root of a quadratic equation in the form that does not cancel
  pure real(wp) function curve_distance(a, b, middle, p) result(distance)
    real(wp), intent(in) :: a(2), b(2), middle(2), p(2)
    real(wp) :: along(2), length, half, centre(2), d_t, d_n, t, xi
    distance = line_distance(a, b, p)
    length = norm2(b - a)
    along = (b - a)/length
    centre = 0.5_wp*(a + b)
    d_t = dot_product(middle - centre, along)
    d_n = along(1)*(middle(2) - centre(2)) - along(2)*(middle(1) - centre(1))
    if (abs(d_n) <= 1.0e-12_wp*length) return
    half = 0.5_wp*length
    t = dot_product(p - centre, along)
    if (abs(t) >= half) return
    xi = 2.0_wp*(t - d_t)/(half + sqrt(max(half**2 - 4.0_wp*d_t*(t - d_t), 0.0_wp)))
    distance = distance - max(1.0_wp - xi**2, 0.0_wp)*d_n
  end function curve_distance

  !> Distance of p from the plane of a triangle, positive where its corners turn counter-clockwise [cells]
  pure real(wp) function face_distance(x, node, p) result(distance)
    real(wp), intent(in) :: x(:, :)
    integer, intent(in) :: node(3)
    real(wp), intent(in) :: p(3)
    integer :: a, b, c
    real(wp) :: n(3)
    logical :: turned
    a = minval(node)
    c = maxval(node)
    b = node(1) + node(2) + node(3) - a - c
    turned = .not. (all(node == [a, b, c]) .or. all(node == [b, c, a]) .or. all(node == [c, a, b]))
    n = cross(x(:, b) - x(:, a), x(:, c) - x(:, a))
    distance = dot_product(n, p - x(:, a))/norm2(n)
    if (turned) distance = -distance
  end function face_distance

  !> Distance of p from a quadrilateral face folded along the diagonal through its lowest node, positive where its corners turn
  !> counter-clockwise [cells]
  pure real(wp) function fold_distance(x, node, p) result(distance)
    real(wp), intent(in) :: x(:, :)
    integer, intent(in) :: node(4)
    real(wp), intent(in) :: p(3)
    integer :: triangle(3, 2)
    logical :: turned, valley
    call see_fold(x, node, triangle, turned, valley)
    if (valley) then
      distance = min(face_distance(x, triangle(:, 1), p), face_distance(x, triangle(:, 2), p))
    else
      distance = max(face_distance(x, triangle(:, 1), p), face_distance(x, triangle(:, 2), p))
    end if
    if (turned) distance = -distance
  end function fold_distance

  !> A folded face as both its neighbours see it: from the side where of the two nodes off the diagonal the lower one comes first
  pure subroutine see_fold(x, node, triangle, turned, valley)
    real(wp), intent(in) :: x(:, :)
    integer, intent(in) :: node(4)
    integer, intent(out) :: triangle(3, 2) !! their nodes, counter-clockwise from there
    logical, intent(out) :: turned !! corners of `node` turn clockwise from there
    logical, intent(out) :: valley !! the other one is not below the triangle of the first
    integer :: ring(4), k
    k = minloc(node, dim=1)
    ring = node(1 + modulo([k - 1, k, k + 1, k + 2], 4))
    turned = ring(2) > ring(4)
    if (turned) ring(2:4) = ring(4:2:-1)
    triangle(:, 1) = ring(1:3)
    triangle(:, 2) = [ring(1), ring(3), ring(4)]
    valley = face_distance(x, triangle(:, 1), x(:, ring(4))) >= 0.0_wp
  end subroutine see_fold

  pure function cross(a, b) result(c)
    real(wp), intent(in) :: a(3), b(3)
    real(wp) :: c(3)
    c = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
  end function cross

  !> Move x to the nearest point of a boundary side, or as little further inwards as rounding asks for [cells]
  pure subroutine onto_side(mesh, side, x)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: side !! number of the boundary side; 0: nothing is done
    real(wp), intent(inout) :: x(mesh%dim)
    integer :: e, s, node(most_side_corners), triangle(3, 2), middle, try
    real(wp) :: foot(mesh%dim), other(mesh%dim), centre(mesh%dim), value(most_sides), share
    logical :: turned, valley
    if (side < 1) return
    e = mesh%side_element(side)
    s = mesh%side_number(side)
    node = side_nodes(mesh, e, s)
    select case (mesh%dim)
    case (1)
      foot = mesh%x(:, node(1))
    case (2)
      middle = middle_node(mesh, e, s)
      if (middle == 0) then
        foot = nearest_on_line(mesh%x(:, node(1)), mesh%x(:, node(2)), x)
      else
        foot = nearest_on_curve(mesh%x(:, node(1)), mesh%x(:, node(2)), mesh%x(:, middle), x)
      end if
    case default
      if (side_corners(mesh%kind(e)) == 3) then
        foot = nearest_on_triangle(mesh%x(:, node(1)), mesh%x(:, node(2)), mesh%x(:, node(3)), x)
      else
        call see_fold(mesh%x, node, triangle, turned, valley)
        foot = nearest_on_triangle(mesh%x(:, triangle(1, 1)), mesh%x(:, triangle(2, 1)), mesh%x(:, triangle(3, 1)), x)
        other = nearest_on_triangle(mesh%x(:, triangle(1, 2)), mesh%x(:, triangle(2, 2)), mesh%x(:, triangle(3, 2)), x)
        if (sum((other - x)**2) < sum((foot - x)**2)) foot = other
      end if
    end select
    centre = sum(mesh%x(:, mesh%node(:kind_corners(mesh%kind(e)), e)), 2)/kind_corners(mesh%kind(e))
    share = 0.0_wp
    do try = 1, 20
      x = foot + share*(centre - foot)
      call side_values(mesh, e, x, value)
      if (all(value >= 0.0_wp)) exit
      share = max(4.0_wp*share, epsilon(1.0_wp))
    end do
  end subroutine onto_side

  !> The point between a and b that is nearest to p
  pure function nearest_on_line(a, b, p) result(foot)
    real(wp), intent(in) :: a(:), b(:), p(:)
    real(wp) :: foot(size(a))
    real(wp) :: t
    t = dot_product(p - a, b - a)/dot_product(b - a, b - a)
    if (t <= 0.0_wp) then
      foot = a
    else if (t >= 1.0_wp) then
      foot = b
    else
      foot = a + t*(b - a)
    end if
  end function nearest_on_line

  !> The point of a quadratic edge that is nearest to p: the best of some, then Newton's method on the squared distance, which it may not raise
  pure function nearest_on_curve(a, b, middle, p) result(foot)
    real(wp), intent(in) :: a(2), b(2), middle(2), p(2)
    real(wp) :: foot(2)
    integer, parameter :: pieces = 8
    real(wp) :: bend(2), slope(2), apart(2), xi, next, least, distance, curvature
    integer :: k
    bend = middle - 0.5_wp*(a + b)
    least = huge(1.0_wp)
    xi = 0.0_wp
    do k = -pieces, pieces
      next = real(k, wp)/pieces
      distance = sum((on_curve(next) - p)**2)
      if (distance < least) xi = next
      least = min(distance, least)
    end do
    do k = 1, 20
      slope = 0.5_wp*(b - a) - 2.0_wp*xi*bend
      apart = on_curve(xi) - p
      curvature = dot_product(slope, slope) - 2.0_wp*dot_product(apart, bend)
      if (curvature <= 0.0_wp) exit
      next = max(-1.0_wp, min(1.0_wp, xi - dot_product(apart, slope)/curvature))
      distance = sum((on_curve(next) - p)**2)
      if (distance >= least) exit
      xi = next
      least = distance
    end do
    foot = on_curve(xi)

  contains

    pure function on_curve(at) result(place)
      real(wp), intent(in) :: at
      real(wp) :: place(2)
      place = 0.5_wp*((1.0_wp - at)*a + (1.0_wp + at)*b) + (1.0_wp - at**2)*bend
    end function on_curve

  end function nearest_on_curve

  !> The point of a triangle in space that is nearest to p: its foot on the plane, or the nearest point of the edges
  pure function nearest_on_triangle(a, b, c, p) result(foot)
    real(wp), intent(in) :: a(3), b(3), c(3), p(3)
    real(wp) :: foot(3)
    real(wp) :: n(3), trial(3, 3), share(3), square
    integer :: k
    n = cross(b - a, c - a)
    square = dot_product(n, n)
    share = [dot_product(n, cross(b - p, c - p)), dot_product(n, cross(c - p, a - p)), dot_product(n, cross(a - p, b - p))]/square
    if (all(share >= 0.0_wp)) then
      foot = p - n*(dot_product(n, p - a)/square)
      return
    end if
    trial(:, 1) = nearest_on_line(a, b, p)
    trial(:, 2) = nearest_on_line(b, c, p)
    trial(:, 3) = nearest_on_line(c, a, p)
    k = minloc([(sum((trial(:, k) - p)**2), k=1, 3)], dim=1)
    foot = trial(:, k)
  end function nearest_on_triangle

end module gimp_sides
