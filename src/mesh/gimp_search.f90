!> Which element of a mesh a point is in: the search directed by the velocity, and the one that knows nothing beforehand.
!>
!> A point that has left its element is sought
!>   1. around the vertices B that it passed: those of violated sides, the ones that most violated sides share first, among equals in the order
!>      of n_B.v/|n_B|, n_B = sum of the edges of the element that reach B (the notes' step 3, ranked). The elements around B follow in the
!>      order of how far they lie in the direction from B to the point. Where one side alone is violated, of the element left or of one just
!>      tested, the element across it goes before them (of the element left only while the point is low over the side);
!>   2. across the side that is violated most, again and again, from the nearest element seen so far; those visited last are not entered again;
!>   3. in rings of neighbours of neighbours, three at most, where the walk went in a circle;
!>   4. in buckets: boxes that list the elements that reach into them. They decide alone who has left the mesh, whatever its outline.
!> Ownership of points on sides: see gimp_sides. The answer to "who owns it" does not depend on where the search starts.
module gimp_search
  use gimp_kinds, only: wp, dp
  use gimp_mesh, only: mesh_t, tetrahedron4, hexahedron8, kind_corners, kind_sides, side_of_kind, side_corners, kind_nodes, most_side_corners
  use gimp_sides, only: slack, most_sides, side_values, side_value, side_plane, ends_at_both, owner_near, onto_side
  implicit none(type, external)
  private
  public :: locator_t, found_t, make_locator, find_element, find_anywhere, owns, onto_side
  public :: found_here, found_vertex, found_walk, found_rings, found_buckets, found_outside, rule_velocity, rule_component

  integer, parameter :: found_here = 1, found_vertex = 2, found_walk = 3, found_rings = 4, found_buckets = 5, found_outside = 6
  integer, parameter :: rule_velocity = 1 !! vertices ranked by n_B.v
  integer, parameter :: rule_component = 2 !! the notes' rule: vertices, in their order, where no component of n_B times that of v is negative

  !> What makes searching fast; built once
  type :: locator_t
    real(wp), allocatable :: plane(:, :, :, :) !! (dim + 1, part, side, element) unit vector into the element, and how far along it all is within
    real(wp), allocatable :: band(:, :) !! (side, element) the width between there and where all is without [cells]
    logical, allocatable :: both(:, :) !! (side, element) a point is without only if it is so for both parts of the side
    real(wp), allocatable :: centre(:, :) !! (dim, element) [cells]
    real(wp), allocatable :: reach(:) !! (element) the farthest corner from the centre, squared
    real(wp) :: low(3) = 0.0_wp, high(3) = 0.0_wp !! the box of all buckets [cells]
    real(wp) :: per_length(3) = 0.0_wp !! 1/edge of a bucket
    integer :: buckets(3) = 1
    integer, allocatable :: bucket_first(:), bucket_element(:) !! elements that reach into a bucket, the likeliest first
  end type locator_t

  !> Where a point is
  type :: found_t
    integer :: element = 0 !! the owner; outside: the element that was left last (0 if none is known)
    integer :: how = found_outside
    integer :: visits = 0 !! elements tested
    integer :: side = 0 !! outside: number of the boundary side that was crossed (0 if none is known)
  end type found_t

  integer, parameter :: tests_at_vertices = 3, best_vertices = 2 !! limits of the first stage
  integer, parameter :: most_corners = 8, most_tested = 200
  integer, parameter :: most_remembered = 8, longest_walk = 400, rings = 3, most_in_rings = 200
  real(wp), parameter :: far = 9.0_wp !! squared: points farther off than three times the element's reach are walked to

contains

  !> Who owns x: element `start`, where the point was, is tried first. v is any vector along the motion, zero if it is not known; a `start`
  !> outside of 1 .. elements means that nothing is known
  pure subroutine find_element(mesh, locator, rule, x, v, start, found)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: rule !! rule_velocity or rule_component
    real(wp), intent(in) :: x(mesh%dim) !! [cells]
    real(wp), intent(in) :: v(mesh%dim) !! any unit
    integer, intent(in) :: start
    type(found_t), intent(out) :: found
    real(wp) :: value(most_sides), along(3)
    integer :: nearest, side
    if (start < 1 .or. start > mesh%elements) then
      call find_anywhere(mesh, locator, x, found)
      return
    end if
    found%visits = 1
    found%element = start
    found%how = found_here
    if (is_deep(mesh%dim, locator, start, x)) return
    if (.not. all(abs(x) < huge(1.0_wp))) then ! nothing can be said about such places
      found%how = found_outside
      return
    end if
    call look_into(mesh, locator, start, x, found, value)
    if (found%element > 0) then
      if (found%element /= start) found%how = found_vertex
      return
    end if
    along(:mesh%dim) = v
    if (all(v == 0.0_wp)) along(:mesh%dim) = x - locator%centre(:, start)
    nearest = start
    if (sum((x - locator%centre(:, start))**2) < far*locator%reach(start)) then
      found%how = found_vertex
      call look_around_vertices(mesh, locator, rule, x, along(:mesh%dim), start, nearest, value, found)
      if (found%element > 0) return
    end if
    call walk(mesh, locator, x, nearest, value, found, side)
    if (found%element > 0) return
    if (side == 0) call look_in_rings(mesh, locator, x, nearest, found)
    if (found%element > 0) return
    call look_in_bucket(mesh, locator, x, found)
    if (found%element > 0) return
    found%how = found_outside
    found%side = side
    if (side == 0) found%side = nearest_side(mesh, x)
    found%element = mesh%side_element(found%side)
  end subroutine find_element

  !> Who owns x, with nothing known beforehand
  pure subroutine find_anywhere(mesh, locator, x, found, hint)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    real(wp), intent(in) :: x(mesh%dim) !! [cells]
    type(found_t), intent(out) :: found
    integer, intent(in), optional :: hint !! an element to look into first, as the last one of a row of points; 0: none
    if (present(hint)) then
      if (hint > 0) then
        found = found_t(element=hint, how=found_here, visits=1)
        if (is_deep(mesh%dim, locator, hint, x)) return
      end if
    end if
    call look_in_bucket(mesh, locator, x, found)
    if (found%element == 0) found%how = found_outside
  end subroutine find_anywhere

  !> Is e the one element that owns x?
  pure logical function owns(mesh, e, x)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp), intent(in) :: x(mesh%dim) !! [cells]
    real(wp) :: value(most_sides)
    integer :: owner, tested
    call side_values(mesh, e, x, value)
    owns = minval(value) > slack
    if (owns .or. .not. minval(value) >= -slack) return
    call owner_near(mesh, e, x, value, owner, tested)
    owns = owner == e
  end function owns

  !> Is x within element e, farther from its sides than rounding reaches? The test that nearly all particles pass
  pure logical function is_deep(dim, locator, e, x)
    integer, intent(in) :: dim
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: e
    real(wp), intent(in) :: x(dim)
    integer :: s
    is_deep = .false.
    if (size(locator%plane, 2) == 2) then
      do s = 1, size(locator%plane, 3)
        if (.not. beyond_planes(locator, e, s, x) > 0.0_wp) return
      end do
    else if (dim == 2) then
      do s = 1, size(locator%plane, 3)
        if (.not. locator%plane(1, 1, s, e)*x(1) + locator%plane(2, 1, s, e)*x(2) > locator%plane(3, 1, s, e)) return
      end do
    else if (dim == 3) then
      do s = 1, size(locator%plane, 3)
        if (.not. locator%plane(1, 1, s, e)*x(1) + locator%plane(2, 1, s, e)*x(2) + locator%plane(3, 1, s, e)*x(3) &
          > locator%plane(4, 1, s, e)) return
      end do
    else
      if (.not. all(locator%plane(1, 1, :, e)*x(1) > locator%plane(2, 1, :, e))) return
    end if
    is_deep = .true.
  end function is_deep

  !> How far x is within side s of element e by its planes [cells]
  pure real(wp) function beyond_planes(locator, e, s, x) result(distance)
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: e, s
    real(wp), intent(in) :: x(:)
    real(wp) :: of_part(2)
    integer :: part, d
    do part = 1, size(locator%plane, 2)
      of_part(part) = -locator%plane(size(x) + 1, part, s, e)
      do d = 1, size(x)
        of_part(part) = of_part(part) + locator%plane(d, part, s, e)*x(d)
      end do
    end do
    distance = of_part(1)
    if (size(locator%plane, 2) == 1) return
    distance = min(distance, of_part(2))
    if (locator%both(s, e)) distance = max(of_part(1), of_part(2))
  end function beyond_planes

  !> The functions of the sides of e near enough to tell where x is: those within `slack` and those of curves are exact, others may differ by
  !> some `slack` but not in sign
  pure subroutine guess_values(mesh, locator, e, x, value)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: e
    real(wp), intent(in) :: x(mesh%dim)
    real(wp), intent(out) :: value(most_sides)
    integer :: s
    value = huge(1.0_wp)
    do s = 1, kind_sides(mesh%kind(e))
      value(s) = beyond_planes(locator, e, s, x)
      if (value(s) > 0.0_wp) then
        value(s) = value(s) + 2.0_wp*slack
      else if (value(s) < -locator%band(s, e)) then
        value(s) = value(s) + (locator%band(s, e) - 2.0_wp*slack)
      else
        value(s) = side_value(mesh, e, s, x)
      end if
    end do
  end subroutine guess_values

  !> If no side of e rules it out, found%element becomes the owner of x, e itself or one beside it, else 0
  pure subroutine look_into(mesh, locator, e, x, found, value)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: e
    real(wp), intent(in) :: x(mesh%dim)
    type(found_t), intent(inout) :: found
    real(wp), intent(out) :: value(most_sides) !! functions of the sides of e as of `guess_values`
    real(wp) :: least
    integer :: tested
    call guess_values(mesh, locator, e, x, value)
    least = minval(value)
    found%element = 0
    if (.not. least >= -slack) return
    found%element = e
    if (least > slack) return
    call side_values(mesh, e, x, value)
    call owner_near(mesh, e, x, value, found%element, tested)
    found%visits = found%visits + tested
  end subroutine look_into

  !> Test element e: found%element becomes the owner of x or 0
  pure subroutine test_element(mesh, locator, e, x, found, value)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: e
    real(wp), intent(in) :: x(mesh%dim)
    type(found_t), intent(inout) :: found
    real(wp), intent(out) :: value(most_sides) !! only if it is not found
    found%visits = found%visits + 1
    found%element = e
    if (is_deep(mesh%dim, locator, e, x)) return
    call look_into(mesh, locator, e, x, found, value)
  end subroutine test_element

  !> First stage: elements around the vertices of `start` that the motion points to. `value` comes with the functions of `start`; it goes with
  !> those of `nearest`, the one of the elements tested that is violated least
  pure subroutine look_around_vertices(mesh, locator, rule, x, v, start, nearest, value, found)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: rule
    real(wp), intent(in) :: x(mesh%dim), v(mesh%dim)
    integer, intent(in) :: start
    integer, intent(out) :: nearest
    real(wp), intent(inout) :: value(most_sides)
    type(found_t), intent(inout) :: found
    integer :: corner(most_corners), corners, tested(most_tested), n, most, k, s, next
    real(wp) :: trial(most_sides)
    nearest = start
    tested(1) = start
    n = 1
    call rank_vertices(mesh, rule, v, start, value, corner, corners)
    most = most_tested
    next = 0
    if (rule == rule_velocity) then
      most = 1 + tests_at_vertices
      next = straight_across(mesh, locator, x, start, mesh%node(corner(1), start), value)
    end if
    k = 1
    do while (n < most)
      do while (next == 0)
        if (k > corners) return
        next = next_around(mesh, locator, rule, x, mesh%node(corner(k), start), tested(:n))
        if (next == 0) k = k + 1
      end do
      call test_element(mesh, locator, next, x, found, trial)
      if (found%element > 0) return
      if (minval(trial) > minval(value)) then
        nearest = next
        value = trial
      end if
      n = n + 1
      tested(n) = next
      next = 0
      if (rule == rule_velocity .and. count(trial < -slack) == 1) then
        next = max(mesh%across(minloc(trial, dim=1), tested(n)), 0)
        if (any(tested(:n) == next)) next = 0
      end if
    end do
  end subroutine look_around_vertices

  !> The element across the side of e that alone is violated, if x stands low over that side as seen from the vertex: not half as steep as the
  !> centre of that element; else 0
  pure integer function straight_across(mesh, locator, x, e, vertex, value) result(next)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    real(wp), intent(in) :: x(mesh%dim)
    integer, intent(in) :: e, vertex
    real(wp), intent(in) :: value(most_sides) !! functions of the sides of e
    real(wp) :: to_point, to_centre
    integer :: s
    next = 0
    if (count(value < -slack) /= 1) return
    s = minloc(value, dim=1)
    if (mesh%across(s, e) < 0) return
    next = mesh%across(s, e)
    to_point = norm2(x - mesh%x(:, vertex))
    to_centre = norm2(locator%centre(:, next) - mesh%x(:, vertex))
    if (-value(s)*to_centre > -0.5_wp*beyond_planes(locator, e, s, locator%centre(:, next))*to_point) next = 0
  end function straight_across

  !> Corners of element e in the order in which the rule looks around them
  pure subroutine rank_vertices(mesh, rule, v, e, value, corner, corners)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: rule
    real(wp), intent(in) :: v(mesh%dim)
    integer, intent(in) :: e
    real(wp), intent(in) :: value(most_sides) !! functions of the sides of e
    integer, intent(out) :: corner(most_corners), corners
    real(wp) :: n_b(3), score(most_corners), speed
    integer :: violated(most_corners), of_side(most_side_corners), kind, k, s
    kind = mesh%kind(e)
    violated = 0
    do s = 1, kind_sides(kind)
      if (value(s) >= -slack) cycle
      of_side = side_of_kind(kind, s)
      do k = 1, side_corners(kind)
        violated(of_side(k)) = violated(of_side(k)) + 1
      end do
    end do
    score = -huge(1.0_wp)
    speed = norm2(v)
    corners = 0
    do k = 1, kind_corners(kind)
      if (rule == rule_velocity .and. violated(k) == 0) cycle
      call vertex_direction(mesh, e, k, n_b)
      if (rule == rule_component) then
        if (any(n_b(:mesh%dim)*v < 0.0_wp)) cycle
        corners = corners + 1
        corner(corners) = k
      else
        score(k) = 4.0_wp*violated(k) + dot_product(n_b(:mesh%dim), v)/(norm2(n_b)*speed) ! the second is within -1 and 1
      end if
    end do
    if (rule == rule_component) return
    do while (corners < best_vertices)
      k = maxloc(score, dim=1)
      if (score(k) < 0.0_wp) exit
      corners = corners + 1
      corner(corners) = k
      score(k) = -huge(1.0_wp)
    end do
  end subroutine rank_vertices

  !> The notes' n_B: sum of the edges of element e that reach its corner k; points outwards
  pure subroutine vertex_direction(mesh, e, k, n_b)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e, k
    real(wp), intent(out) :: n_b(3)
    integer :: other
    n_b = 0.0_wp
    do other = 1, kind_corners(mesh%kind(e))
      if (other == k .or. .not. have_edge(mesh%kind(e), k, other)) cycle
      n_b(:mesh%dim) = n_b(:mesh%dim) + (mesh%x(:, mesh%node(k, e)) - mesh%x(:, mesh%node(other, e)))
    end do
  end subroutine vertex_direction

  !> Is there an edge between two corners of an element of a kind?
  pure logical function have_edge(kind, a, b)
    integer, intent(in) :: kind, a, b
    integer :: corners
    corners = kind_corners(kind)
    if (kind == hexahedron8) then
      have_edge = abs(a - b) == 4 .or. ((a > 4 .eqv. b > 4) .and. modulo(a - b, 2) == 1)
    else if (corners == 4 .and. kind /= tetrahedron4) then
      have_edge = modulo(a - b, 2) == 1
    else
      have_edge = .true. ! lines, triangles, tetrahedra
    end if
  end function have_edge

  !> The element around a vertex to test next: the first of the list by the notes' rule, else the one that lies farthest in the direction of x,
  !> told by its centre; 0 if all were tested
  pure integer function next_around(mesh, locator, rule, x, vertex, tested) result(next)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: rule
    real(wp), intent(in) :: x(mesh%dim)
    integer, intent(in) :: vertex, tested(:)
    real(wp) :: ahead, most, along(3)
    integer :: i, e
    next = 0
    most = -huge(1.0_wp)
    do i = mesh%vertex_first(vertex), mesh%vertex_first(vertex + 1) - 1
      e = mesh%vertex_element(i)
      if (any(tested == e)) cycle
      along(:mesh%dim) = locator%centre(:, e) - mesh%x(:, vertex)
      ahead = dot_product(x - mesh%x(:, vertex), along(:mesh%dim))/norm2(along(:mesh%dim))
      if (ahead <= most) cycle
      next = e
      if (rule == rule_component) return
      most = ahead
    end do
  end function next_around

  !> Second stage: from element e with functions `value` across the side that is violated most, but not into those visited last. Ends in the
  !> owner; or where sides of the boundary alone are violated; or nowhere, e being the last element
  pure subroutine walk(mesh, locator, x, e, value, found, side)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    real(wp), intent(in) :: x(mesh%dim)
    integer, intent(inout) :: e
    real(wp), intent(inout) :: value(most_sides)
    type(found_t), intent(inout) :: found
    integer, intent(out) :: side !! the boundary side that was reached last; 0: none
    integer :: remembered(most_remembered), step, s, beyond, next
    real(wp) :: worst, worst_boundary
    found%how = found_walk
    side = 0
    remembered = 0
    do step = 1, longest_walk
      remembered(1 + modulo(step, most_remembered)) = e
      next = 0
      worst = -slack
      worst_boundary = -slack
      do s = 1, kind_sides(mesh%kind(e))
        beyond = mesh%across(s, e)
        if (beyond < 0) then
          if (value(s) >= worst_boundary) cycle
          worst_boundary = value(s)
          side = -beyond
        else if (value(s) < worst) then
          if (any(remembered == beyond)) cycle
          worst = value(s)
          next = beyond
        end if
      end do
      if (next == 0) return
      e = next
      call test_element(mesh, locator, e, x, found, value)
      if (found%element > 0) return
    end do
  end subroutine walk

  !> Third stage: neighbours of e, their neighbours, and theirs
  pure subroutine look_in_rings(mesh, locator, x, e, found)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    real(wp), intent(in) :: x(mesh%dim)
    integer, intent(in) :: e
    type(found_t), intent(inout) :: found
    integer :: list(most_in_rings), ring, first, last, n, i, s, next
    real(wp) :: value(most_sides)
    found%how = found_rings
    list(1) = e
    n = 1
    last = 0
    do ring = 1, rings
      first = last + 1
      last = n
      do i = first, last
        do s = 1, kind_sides(mesh%kind(list(i)))
          next = mesh%across(s, list(i))
          if (next < 0 .or. n == most_in_rings) cycle
          if (any(list(:n) == next)) cycle
          n = n + 1
          list(n) = next
          call test_element(mesh, locator, next, x, found, value)
          if (found%element > 0) return
        end do
      end do
    end do
  end subroutine look_in_rings

  !> Last stage, exact: all elements that reach into the bucket of x
  pure subroutine look_in_bucket(mesh, locator, x, found)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    real(wp), intent(in) :: x(mesh%dim)
    type(found_t), intent(inout) :: found
    real(wp) :: value(most_sides)
    integer :: d, bucket, k
    found%how = found_buckets
    found%element = 0
    bucket = 0
    do d = mesh%dim, 1, -1
      if (.not. (x(d) >= locator%low(d) .and. x(d) <= locator%high(d))) return
      bucket = locator%buckets(d)*bucket + bucket_along(locator, d, x(d))
    end do
    do k = locator%bucket_first(bucket + 1), locator%bucket_first(bucket + 2) - 1
      call test_element(mesh, locator, locator%bucket_element(k), x, found, value)
      if (found%element > 0) return
    end do
  end subroutine look_in_bucket

  !> Which bucket along an axis, from 0
  pure integer function bucket_along(locator, d, x) result(at)
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: d
    real(wp), intent(in) :: x !! within the box of buckets [cells]
    at = min(int((x - locator%low(d))*locator%per_length(d)), locator%buckets(d) - 1)
  end function bucket_along

  !> The boundary side nearest to x; looks at all of them, for points outside that no walk came near to
  pure integer function nearest_side(mesh, x) result(side)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: x(mesh%dim)
    real(wp) :: foot(mesh%dim), least
    integer :: k
    side = 1
    least = huge(1.0_wp)
    do k = 1, size(mesh%side_element)
      foot = x
      call onto_side(mesh, k, foot)
      if (sum((foot - x)**2) >= least) cycle
      least = sum((foot - x)**2)
      side = k
    end do
  end function nearest_side

  !> Build what searching needs, once the mesh is connected; time and memory in proportion to the number of elements
  subroutine make_locator(mesh, locator)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(out) :: locator
    real(wp), allocatable :: box(:, :, :) !! (dim, low and high, element)
    real(wp) :: middle(3), outer
    integer :: dim, sides, parts, e, s, k, part
    dim = mesh%dim
    sides = size(mesh%across, 1)
    parts = merge(2, 1, any(mesh%kind == hexahedron8))
    allocate (locator%plane(dim + 1, parts, sides, mesh%elements), source=0.0_wp)
    allocate (locator%band(sides, mesh%elements), source=1.0_wp)
    allocate (locator%both(sides, mesh%elements), source=.false.)
    allocate (locator%centre(dim, mesh%elements), locator%reach(mesh%elements), box(dim, 2, mesh%elements))
    locator%plane(dim + 1, :, :, :) = -0.5_wp ! sides that other kinds have exclude nothing
    do e = 1, mesh%elements
      middle = 0.0_wp
      do k = 1, kind_corners(mesh%kind(e))
        middle(:dim) = middle(:dim) + mesh%x(:, mesh%node(k, e))/kind_corners(mesh%kind(e))
      end do
      locator%centre(:, e) = middle(:dim)
      locator%reach(e) = 0.0_wp
      do k = 1, kind_nodes(mesh%kind(e))
        locator%reach(e) = max(locator%reach(e), sum((mesh%x(:, mesh%node(k, e)) - middle(:dim))**2))
      end do
      call box_of_element(mesh, e, box(:, :, e))
      do s = 1, kind_sides(mesh%kind(e))
        do part = 1, parts
          call side_plane(mesh, e, s, part, locator%plane(:dim, part, s, e), locator%plane(dim + 1, part, s, e), outer)
        end do
        locator%band(s, e) = locator%plane(dim + 1, parts, s, e) - outer
        if (parts == 2) locator%both(s, e) = ends_at_both(mesh, e, s)
      end do
    end do
    call choose_buckets(mesh, box, locator)
    call fill_buckets(mesh, box, locator)
  end subroutine make_locator

  !> A box around an element, wider by what rounding asks for
  pure subroutine box_of_element(mesh, e, box)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp), intent(out) :: box(mesh%dim, 2)
    real(wp) :: pole(2), margin
    integer :: k, s, corners
    corners = kind_corners(mesh%kind(e))
    box(:, 1) = mesh%x(:, mesh%node(1, e))
    box(:, 2) = mesh%x(:, mesh%node(1, e))
    do k = 2, corners
      box(:, 1) = min(box(:, 1), mesh%x(:, mesh%node(k, e)))
      box(:, 2) = max(box(:, 2), mesh%x(:, mesh%node(k, e)))
    end do
    if (kind_nodes(mesh%kind(e)) > corners .and. mesh%dim == 2) then ! a parabola stays within its control points
      do s = 1, corners
        k = 1 + modulo(s, corners)
        pole = 2.0_wp*mesh%x(1:2, mesh%node(corners + s, e)) - 0.5_wp*(mesh%x(1:2, mesh%node(s, e)) + mesh%x(1:2, mesh%node(k, e)))
        box(:, 1) = min(box(:, 1), pole)
        box(:, 2) = max(box(:, 2), pole)
      end do
    end if
    margin = 4.0_wp*slack + 8.0_wp*epsilon(1.0_wp)*maxval(abs(box))
    box(:, 1) = box(:, 1) - margin
    box(:, 2) = box(:, 2) + margin
  end subroutine box_of_element

  !> The size of buckets: half the mean size of elements, more where that would make too many or too long lists
  subroutine choose_buckets(mesh, box, locator)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: box(:, :, :)
    type(locator_t), intent(inout) :: locator
    real(wp) :: edge(mesh%dim)
    real(dp) :: listed, lists
    integer :: dim, e, d
    dim = mesh%dim
    locator%low(:dim) = minval(box(:, 1, :), 2)
    locator%high(:dim) = maxval(box(:, 2, :), 2)
    edge = 0.5_wp*sum(box(:, 2, :) - box(:, 1, :), 2)/mesh%elements
    do
      if (product(1.0_dp + (locator%high(:dim) - locator%low(:dim))/edge) <= 16.0_dp*mesh%elements + 64.0_dp) then
        listed = 0.0_dp
        do e = 1, mesh%elements
          lists = 1.0_dp
          do d = 1, dim
            lists = lists*(2.0_dp + (box(d, 2, e) - box(d, 1, e))/edge(d))
          end do
          listed = listed + lists
        end do
        if (listed <= 80.0_dp*mesh%elements) exit
      end if
      edge = 1.25_wp*edge
    end do
    locator%buckets(:dim) = 1 + int((locator%high(:dim) - locator%low(:dim))/edge)
    locator%per_length(:dim) = 1.0_wp/edge
  end subroutine choose_buckets

  !> Note in every bucket which elements reach into it: count, sum, fill; then sort each list
  subroutine fill_buckets(mesh, box, locator)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: box(:, :, :)
    type(locator_t), intent(inout) :: locator
    integer, allocatable :: place(:)
    real(wp) :: low(3), high(3), bucket_low(3), bucket_high(3)
    integer :: pass, e, d, first(3), last(3), i, j, k, bucket
    allocate (locator%bucket_first(product(locator%buckets) + 1), source=0)
    do pass = 1, 2
      do e = 1, mesh%elements
        first = 0
        last = 0
        do d = 1, mesh%dim
          first(d) = bucket_along(locator, d, box(d, 1, e))
          last(d) = bucket_along(locator, d, box(d, 2, e))
          low(d) = box(d, 1, e)
          high(d) = box(d, 2, e)
        end do
        do k = first(3), last(3)
          do j = first(2), last(2)
            do i = first(1), last(1)
              do d = 1, mesh%dim
                bucket = merge(i, merge(j, k, d == 2), d == 1)
                bucket_low(d) = max(low(d), locator%low(d) + bucket/locator%per_length(d) - 4.0_wp*slack)
                bucket_high(d) = min(high(d), locator%low(d) + (bucket + 1)/locator%per_length(d) + 4.0_wp*slack)
              end do
              if (.not. reaches(locator, e, bucket_low(:mesh%dim), bucket_high(:mesh%dim))) cycle
              bucket = 1 + i + locator%buckets(1)*(j + locator%buckets(2)*k)
              if (pass == 1) then
                locator%bucket_first(bucket + 1) = locator%bucket_first(bucket + 1) + 1
              else
                locator%bucket_element(place(bucket)) = e
                place(bucket) = place(bucket) + 1
              end if
            end do
          end do
        end do
      end do
      if (pass == 2) exit
      locator%bucket_first(1) = 1
      do bucket = 2, size(locator%bucket_first)
        locator%bucket_first(bucket) = locator%bucket_first(bucket) + locator%bucket_first(bucket - 1)
      end do
      place = locator%bucket_first
      allocate (locator%bucket_element(place(size(place)) - 1))
    end do
    call sort_buckets(mesh, locator)
  end subroutine fill_buckets

  !> May element e reach into a box? Not if one of its sides has the box on its far side
  pure logical function reaches(locator, e, low, high)
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: e
    real(wp), intent(in) :: low(:), high(:)
    integer :: s, d, part, without
    real(wp) :: most
    reaches = .false.
    do s = 1, size(locator%plane, 3)
      without = 0
      do part = 1, size(locator%plane, 2)
        most = locator%band(s, e) - locator%plane(size(low) + 1, part, s, e)
        do d = 1, size(low)
          most = most + max(locator%plane(d, part, s, e)*low(d), locator%plane(d, part, s, e)*high(d))
        end do
        if (most < 0.0_wp) without = without + 1
      end do
      if (without == size(locator%plane, 2) .or. (without == 1 .and. .not. locator%both(s, e))) return
    end do
    reaches = .true.
  end function reaches

  !> Elements whose centres are near that of the bucket, measured by their size, come first
  pure subroutine sort_buckets(mesh, locator)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(inout) :: locator
    real(wp) :: middle(3), distance
    real(wp), allocatable :: distances(:)
    integer :: bucket, at(3), first, k, i, e
    allocate (distances(mesh%elements))
    do bucket = 1, size(locator%bucket_first) - 1
      at = [modulo(bucket - 1, locator%buckets(1)), modulo((bucket - 1)/locator%buckets(1), locator%buckets(2)), &
        (bucket - 1)/(locator%buckets(1)*locator%buckets(2))]
      middle(:mesh%dim) = locator%low(:mesh%dim) + (at(:mesh%dim) + 0.5_wp)/locator%per_length(:mesh%dim)
      first = locator%bucket_first(bucket)
      do k = first, locator%bucket_first(bucket + 1) - 1
        e = locator%bucket_element(k)
        distance = sum((middle(:mesh%dim) - locator%centre(:, e))**2)/locator%reach(e)
        do i = k - 1, first, -1 ! lists are short
          if (distances(1 + i - first) <= distance) exit
          distances(2 + i - first) = distances(1 + i - first)
          locator%bucket_element(i + 1) = locator%bucket_element(i)
        end do
        distances(2 + i - first) = distance
        locator%bucket_element(i + 1) = e
      end do
    end do
  end subroutine sort_buckets
end module gimp_search
