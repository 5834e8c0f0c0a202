!> Which element of a mesh a point is in: the search directed by the velocity, and the one that knows nothing beforehand.
!>
!> A point that has left its element is sought
!>   1. around the vertices B that it passed: those of violated sides, the ones that most violated sides share first, among equals in the order
!>      of n_B.v/|n_B|, n_B = sum of the edges of the element that reach B (the notes' step 3, ranked). The elements around B follow in the
!>      order of how far they lie in the direction from B to the point. Where one side alone is violated, of the element left or of one just
!>      tested, the element across it goes before them (of the element left only while the point is low over the side);
!>   2. across the side that is violated most, again and again, from the nearest element seen so far; those visited last are not entered again;
!>   3. in rings of neighbours of neighbours, three at most, where the walk went in a circle;
!>   4. in buckets: boxes that list the elements that reach into them. They alone decide who has left the mesh, whatever its outline; points
!>      that are beyond sides of the boundary only, or that walked to such a place, come here at once.
!> Ownership of points on sides: see gimp_sides. The answer to "who owns it" does not depend on where the search starts.
module gimp_search
  use gimp_kinds, only: wp
  use gimp_mesh, only: mesh_t, tetrahedron4, hexahedron8, kind_corners, kind_sides, side_of_kind, side_corners, most_side_corners
  use gimp_sides, only: slack, most_sides, side_values, side_value, owner_near, onto_side
  use gimp_locator, only: locator_t, make_locator, bucket_along
  implicit none(type, external)
  private
  public :: locator_t, found_t, make_locator, find_element, find_anywhere, owns, onto_side
  public :: found_here, found_vertex, found_walk, found_rings, found_buckets, found_outside, rule_velocity, rule_component

  integer, parameter :: found_here = 1, found_vertex = 2, found_walk = 3, found_rings = 4, found_buckets = 5, found_outside = 6
  integer, parameter :: rule_velocity = 1 !! vertices ranked by n_B.v
  integer, parameter :: rule_component = 2 !! the notes' rule: vertices, in their order, where no component of n_B times that of v is negative

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
    side = side_left(mesh, start, value)
    if (side == 0) then
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
    end if
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
    real(wp) :: one, other
    is_deep = .false.
    if (size(locator%plane, 2) == 2) then
      do s = 1, size(locator%plane, 3)
        one = locator%plane(1, 1, s, e)*x(1) + locator%plane(2, 1, s, e)*x(2) + locator%plane(3, 1, s, e)*x(3) - locator%plane(4, 1, s, e)
        other = locator%plane(1, 2, s, e)*x(1) + locator%plane(2, 2, s, e)*x(2) + locator%plane(3, 2, s, e)*x(3) - locator%plane(4, 2, s, e)
        if (one > 0.0_wp .and. other > 0.0_wp) cycle
        if (.not. locator%both(s, e) .or. .not. (one > 0.0_wp .or. other > 0.0_wp)) return
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
      do s = 1, 2
        if (.not. locator%plane(1, 1, s, e)*x(1) > locator%plane(2, 1, s, e)) return
      end do
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

  !> The boundary side by which a point left element e, if it is beyond sides of the boundary only; else 0
  pure integer function side_left(mesh, e, value) result(side)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp), intent(in) :: value(most_sides) !! functions of the sides of e
    integer :: s
    side = 0
    do s = 1, kind_sides(mesh%kind(e))
      if (value(s) < -slack .and. mesh%across(s, e) > 0) return
    end do
    s = minloc(value, dim=1)
    side = -mesh%across(s, e)
  end function side_left

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
    integer :: corner(most_corners), corners, tested(most_tested), n, most, k, next
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

end module gimp_search
