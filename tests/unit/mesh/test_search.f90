!> The search against brute force over all elements, and exactly one owner for every point, however close to sides and vertices.
!> An argument is the number of points and jumps of each kind on each mesh
program test_search
  use gimp_kinds, only: wp, dp
  use gimp_mesh, only: mesh_t, kind_sides, kind_corners, side_corners, side_nodes, most_side_corners
  use gimp_mesh_connect, only: connect_mesh
  use gimp_mesh_renumber, only: renumber_mesh
  use gimp_sides, only: slack, most_sides, side_value, side_values
  use gimp_search, only: locator_t, found_t, make_locator, find_element, find_anywhere, owns, onto_side, found_here, found_outside, &
    rule_velocity, rule_component
  use gimp_made_meshes, only: made_lines, made_triangles, made_quads, made_hybrid, made_tetrahedra, made_hexahedra, made_quadratic, &
    turn_mesh, random_t, random_number_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_text, only: text_of
  implicit none(type, external)
  type(random_t) :: random
  integer :: points = 500

  call begin_suite("search")
  call read_argument()
  call test_known_places()
  call test_complementary_sides()
  call test_all("lines", made_lines(40, 0.3_dp), 0.0_dp)
  call test_all("quads", made_quads([40, 36]), 0.0_dp)
  call test_all("distorted quads", made_quads([36, 36], 0.3_dp), 0.0_dp)
  call test_all("quads turned by 45 degrees", made_quads([36, 36]), 45.0_dp)
  call test_all("triangles", made_triangles([36, 24]), 0.0_dp)
  call test_all("distorted triangles", made_triangles([36, 24], 0.25_dp), 0.0_dp)
  call test_all("hybrid", made_hybrid([36, 30], 0.25_dp), 30.0_dp)
  call test_all("curved triangle6", made_quadratic(made_triangles([36, 20], 0.15_dp), .false., 0.05_dp), 0.0_dp)
  call test_all("straight quad8", made_quadratic(made_quads([34, 30], 0.3_dp), .false.), 0.0_dp)
  call test_all("curved quad9 and triangle6", made_quadratic(made_hybrid([36, 24], 0.15_dp), .true., 0.08_dp), 17.0_dp)
  call test_all("tetrahedra", made_tetrahedra([34, 3, 3]), 0.0_dp)
  call test_all("distorted tetrahedra", made_tetrahedra([10, 6, 5], 0.2_dp), 25.0_dp)
  call test_all("hexahedra", made_hexahedra([34, 6, 6]), 0.0_dp)
  call test_all("distorted hexahedra", made_hexahedra([12, 12, 11], 0.3_dp), 25.0_dp)
  call test_all("quads around a gap", without(made_quads([34, 34], 0.2_dp), [4.0_wp, 8.0_wp], [30.0_wp, 40.0_wp]), 10.0_dp)
  call test_all("hexahedra around a gap", without(made_hexahedra([16, 8, 6], 0.2_dp), [3.0_wp, 2.0_wp, 2.0_wp], &
    [13.0_wp, 9.0_wp, 5.0_wp]), 0.0_dp)
  call test_odd_queries()
  call end_suite()

contains

  subroutine read_argument()
    character(len=16) :: word
    integer :: status
    call get_command_argument(1, word)
    if (len_trim(word) == 0) return
    read (word, *, iostat=status) points
    call check(status, 0, "the argument is a number of points")
  end subroutine read_argument

  !> A mesh with elements in random order: points, jumps, points on sides and vertices, feet on the boundary
  subroutine test_all(name, made, degrees)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: made
    real(dp), intent(in) :: degrees
    type(mesh_t) :: mesh
    type(locator_t) :: locator
    integer, allocatable :: element_order(:), node_order(:)
    mesh = made
    element_order = shuffled(mesh%elements)
    node_order = shuffled(mesh%nodes)
    call renumber_mesh(mesh, element_order, node_order)
    if (degrees /= 0.0_dp) call turn_mesh(mesh, degrees)
    call connect_mesh(mesh)
    call make_locator(mesh, locator)
    call test_points(name, mesh, locator)
    call test_jumps(name//", jumps within a cell", mesh, locator, 1.0_wp)
    call test_jumps(name//", jumps up to 3 cells", mesh, locator, 3.0_wp)
    call test_jumps(name//", jumps up to 30 cells", mesh, locator, 30.0_wp)
    call test_jumps(name//", jumps out of the mesh", mesh, locator, 100.0_wp)
    call test_small_steps(name, mesh, locator)
    call test_ties(name, mesh, locator)
    call test_feet(name, mesh)
  end subroutine test_all

  !> Random points in and around the mesh, sought from nowhere and from random elements, by both rules
  subroutine test_points(name, mesh, locator)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    type(found_t) :: found
    real(wp) :: x(mesh%dim), v(mesh%dim)
    integer :: i, wrong, wrong_from(2), inside, expected, rule
    wrong = 0
    wrong_from = 0
    inside = 0
    do i = 1, points
      x = place_about(mesh, 0.05_wp)
      v = direction(mesh%dim)
      expected = by_brute_force(mesh, x)
      if (expected > 0) inside = inside + 1
      call find_anywhere(mesh, locator, x, found)
      if (merge(found%element, 0, found%how /= found_outside) /= expected) wrong = wrong + 1
      do rule = rule_velocity, rule_component
        call find_element(mesh, locator, rule, x, v, some_element(mesh), found)
        if (.not. agrees(mesh, x, found, expected)) wrong_from(rule) = wrong_from(rule) + 1
      end do
    end do
    call check(wrong, 0, name//": points found from nowhere as by brute force")
    call check(wrong_from(1), 0, name//": points found from random elements")
    call check(wrong_from(2), 0, name//": points found from random elements by the rule of components")
    call check_true(10*inside > points, name//": many of the points lie inside")
  end subroutine test_points

  !> Jumps of up to `longest` from a random place in a random element
  subroutine test_jumps(name, mesh, locator, longest)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    real(wp), intent(in) :: longest !! [cells]
    type(found_t) :: found
    real(wp) :: x(mesh%dim), v(mesh%dim)
    integer :: i, wrong(2), start, expected, rule
    wrong = 0
    do i = 1, points
      start = some_element(mesh)
      x = place_in(mesh, start)
      v = real(random_number_of(random), wp)*longest*direction(mesh%dim)
      if (modulo(i, 4) == 0) v(2:) = 0.0_wp ! along an axis
      x = x + v
      expected = by_brute_force(mesh, x)
      do rule = rule_velocity, rule_component
        call find_element(mesh, locator, rule, x, v, start, found)
        if (.not. agrees(mesh, x, found, expected)) wrong(rule) = wrong(rule) + 1
      end do
    end do
    call check(wrong(1), 0, name//": as by brute force")
    call check(wrong(2), 0, name//": as by brute force by the rule of components")
  end subroutine test_jumps

  !> Steps of a tenth of a cell cost at most 1 + 1.2 P tests, P being the share of particles that leave their element
  subroutine test_small_steps(name, mesh, locator)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    type(found_t) :: found
    real(wp) :: x(mesh%dim), v(mesh%dim)
    integer :: i, start, leave, visits, n
    leave = 0
    visits = 0
    n = 0
    do i = 1, points
      start = some_element(mesh)
      x = place_in(mesh, start)
      v = 0.1_wp*direction(mesh%dim)
      call find_element(mesh, locator, rule_velocity, x + v, v, start, found)
      if (found%how == found_outside) cycle
      n = n + 1
      visits = visits + found%visits
      if (found%element /= start) leave = leave + 1
    end do
    call check_true(visits - n <= 1.2_dp*leave, name//": "//text_of(visits - n)//" more than one test each for "//text_of(n)// &
      " steps of a tenth of a cell, "//text_of(leave)//" of which leave the element")
  end subroutine test_small_steps

  !> Points on sides, edges and vertices, and beside them by an ulp, 1e-16 and more, have one owner, whoever is asked
  subroutine test_ties(name, mesh, locator)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    type(found_t) :: found
    real(wp), parameter :: shifts(6) = [0.0_wp, 1.0e-16_wp, 1.0e-14_wp, 1.0e-12_wp, 1.0e-10_wp, 3.0e-9_wp]
    real(wp) :: x(mesh%dim), v(mesh%dim)
    integer :: i, d, e, owners, owner, wrong_owners, wrong, wrong_outside, start, shift
    wrong_owners = 0
    wrong_outside = 0
    wrong = 0
    do i = 1, points
      e = some_element(mesh)
      x = place_on_side(mesh, e)
      shift = modulo(i, 8) - 2
      if (shift < 0) then
        do d = 1, mesh%dim
          if (random_number_of(random) < 0.7_dp) x(d) = nearest(x(d), real(random_number_of(random) - 0.5_dp, wp))
        end do
      else if (shift > 0) then
        x = x + shifts(shift + 1)*direction(mesh%dim)
      end if
      owner = by_brute_force(mesh, x)
      owners = owners_around(mesh, e, x)
      if (owner == 0 .and. .not. at_boundary(mesh, e)) wrong_outside = wrong_outside + 1
      if (owners /= merge(0, 1, owner == 0)) wrong_owners = wrong_owners + 1
      call find_anywhere(mesh, locator, x, found)
      if (merge(found%element, 0, found%how /= found_outside) /= owner) wrong = wrong + 1
      v = direction(mesh%dim)
      do d = 1, 3
        start = e
        if (d == 2) start = some_neighbour(mesh, e)
        if (d == 3) start = some_element(mesh)
        call find_element(mesh, locator, rule_velocity, x, v, start, found)
        if (.not. agrees(mesh, x, found, owner)) wrong = wrong + 1
      end do
    end do
    call check(wrong_owners, 0, name//": points on and beside sides are owned exactly once")
    call check(wrong_outside, 0, name//": points on and beside inner sides are owned")
    call check(wrong, 0, name//": points on and beside sides are found alike from everywhere")
  end subroutine test_ties

  !> How many of the elements around e own x, each asked by itself
  integer function owners_around(mesh, e, x) result(owners)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp), intent(in) :: x(mesh%dim)
    logical :: asked(mesh%elements)
    integer :: k, i, other
    asked = .false.
    owners = 0
    do k = 1, kind_corners(mesh%kind(e))
      do i = mesh%vertex_first(mesh%node(k, e)), mesh%vertex_first(mesh%node(k, e) + 1) - 1
        other = mesh%vertex_element(i)
        if (asked(other)) cycle
        asked(other) = .true.
        if (owns(mesh, other, x)) owners = owners + 1
      end do
    end do
  end function owners_around

  !> Does element e touch the boundary?
  logical function at_boundary(mesh, e)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    integer :: k, i
    at_boundary = .true.
    do k = 1, kind_corners(mesh%kind(e))
      do i = mesh%vertex_first(mesh%node(k, e)), mesh%vertex_first(mesh%node(k, e) + 1) - 1
        if (any(mesh%across(:kind_sides(mesh%kind(mesh%vertex_element(i))), mesh%vertex_element(i)) < 0)) return
      end do
    end do
    at_boundary = .false.
  end function at_boundary

  !> Points brought back to a boundary side are on it, nobody's distance to it is smaller, and they have an owner
  subroutine test_feet(name, mesh)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: mesh
    real(wp) :: x(mesh%dim), foot(mesh%dim), other(mesh%dim), values(most_sides)
    integer :: i, k, side, e, off, farther, ownerless, unsettled
    off = 0
    farther = 0
    ownerless = 0
    unsettled = 0
    do i = 1, max(points/10, 40)
      side = 1 + int(size(mesh%side_element)*random_number_of(random))
      e = mesh%side_element(side)
      x = place_in(mesh, e) + direction(mesh%dim)
      foot = x
      call onto_side(mesh, side, foot)
      call side_values(mesh, e, foot, values)
      if (abs(values(mesh%side_number(side))) > 1.0e-13_wp) off = off + 1
      if (any(values < 0.0_wp)) unsettled = unsettled + 1
      if (by_brute_force(mesh, foot) == 0) ownerless = ownerless + 1
      do k = 1, 10
        other = place_on(mesh, e, mesh%side_number(side), .true.)
        if (norm2(x - other) < norm2(x - foot) - 1.0e-7_wp) farther = farther + 1 ! on a curve, Newton stops where squares no longer fall
      end do
    end do
    call check(off, 0, name//": feet are on their side")
    call check(unsettled, 0, name//": feet are not outside")
    call check(farther, 0, name//": no point of the side is nearer than the foot")
    call check(ownerless, 0, name//": feet have owners")
  end subroutine test_feet

  !> A grid of unit quads numbered along x: the owner is known without any search, ties go to the lower number
  subroutine test_known_places()
    type(mesh_t) :: mesh
    type(locator_t) :: locator
    type(found_t) :: found
    mesh = made_quads([5, 4])
    call connect_mesh(mesh)
    call make_locator(mesh, locator)
    call find_anywhere(mesh, locator, [3.3_wp, 2.9_wp], found)
    call check(found%element, 14, "a point within an element")
    call find_anywhere(mesh, locator, [3.0_wp, 2.5_wp], found)
    call check(found%element, 13, "on a side: the element with the smaller number")
    call find_anywhere(mesh, locator, [3.0_wp, 2.0_wp], found)
    call check(found%element, 8, "on a vertex: the element with the smallest number")
    call find_anywhere(mesh, locator, [5.0_wp, 4.0_wp], found)
    call check(found%element, 20, "on a corner of the mesh")
    call find_element(mesh, locator, rule_velocity, [3.2_wp, 2.5_wp], [0.3_wp, 0.0_wp], 13, found)
    call check_true(found%element == 14 .and. found%visits == 2, "across a side: two tests")
    call find_element(mesh, locator, rule_velocity, [3.2_wp, 3.1_wp], [0.3_wp, 0.2_wp], 13, found)
    call check_true(found%element == 19 .and. found%visits == 2, "past a vertex: two tests")
    call find_element(mesh, locator, rule_velocity, [2.2_wp, 2.1_wp], [0.3_wp, 0.2_wp], 13, found)
    call check_true(found%element == 13 .and. found%visits == 1 .and. found%how == found_here, "still there: one test")
    call find_element(mesh, locator, rule_velocity, [5.1_wp, 2.1_wp], [0.3_wp, 0.2_wp], 15, found)
    call check_true(found%how == found_outside .and. found%element == 15, "it left the mesh from its element")
    call check_true(mesh%side_element(found%side) == 15 .and. mesh%side_number(found%side) == 2, "by the side that it crossed")
  end subroutine test_known_places

  !> Elements on both sides of a side see opposite numbers, bit for bit
  subroutine test_complementary_sides()
    call check_complementary("quads", made_quads([8, 8], 0.3_dp))
    call check_complementary("curved", made_quadratic(made_hybrid([8, 8], 0.15_dp), .true., 0.08_dp))
    call check_complementary("tetrahedra", made_tetrahedra([4, 4, 4], 0.2_dp))
    call check_complementary("hexahedra", made_hexahedra([5, 5, 5], 0.3_dp))
  end subroutine test_complementary_sides

  subroutine check_complementary(name, made)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: made
    type(mesh_t) :: mesh
    real(wp) :: x(made%dim)
    integer :: e, s, t, other, k, different
    mesh = made
    call connect_mesh(mesh)
    different = 0
    do e = 1, mesh%elements
      do s = 1, kind_sides(mesh%kind(e))
        other = mesh%across(s, e)
        if (other < 0) cycle
        t = findloc(mesh%across(:, other), e, dim=1)
        do k = 1, 5
          x = place_in(mesh, merge(e, other, k > 2))
          if (side_value(mesh, e, s, x) /= -side_value(mesh, other, t, x)) different = different + 1
        end do
        if (side_value(mesh, e, s, place_in(mesh, e)) < 0.0_wp .and. maxval(kind_corners(mesh%kind)) < 5) then
          if (all(mesh%kind == mesh%kind(1)) .and. mesh%kind(1) /= 3) different = different + 1 ! flat sides: within is positive
        end if
      end do
    end do
    call check(different, 0, name//": both neighbours see the same number with opposite signs")
  end subroutine check_complementary

  !> Places that are no numbers, starts that are no elements, and motion that is not known
  subroutine test_odd_queries()
    type(mesh_t) :: mesh
    type(locator_t) :: locator
    type(found_t) :: found
    mesh = made_quads([5, 4], 0.2_dp)
    call connect_mesh(mesh)
    call make_locator(mesh, locator)
    call find_element(mesh, locator, rule_velocity, [1.5_wp, 1.5_wp], [0.0_wp, 0.0_wp], 0, found)
    call check(found%element, by_brute_force(mesh, [1.5_wp, 1.5_wp]), "a start that is no element")
    call find_element(mesh, locator, rule_velocity, [1.9_wp, 1.5_wp], [0.0_wp, 0.0_wp], 2, found)
    call check(found%element, by_brute_force(mesh, [1.9_wp, 1.5_wp]), "no velocity")
    call find_element(mesh, locator, rule_component, [1.9_wp, 1.5_wp], [0.0_wp, 0.0_wp], 2, found)
    call check(found%element, by_brute_force(mesh, [1.9_wp, 1.5_wp]), "no velocity, rule of components")
    call find_element(mesh, locator, rule_velocity, [huge(1.0_wp), 1.5_wp], [1.0_wp, 0.0_wp], 2, found)
    call check(found%how, found_outside, "a place beyond all bounds")
  end subroutine test_odd_queries

  !> Does an answer agree with the owner known (0: outside)? Outside, the side named must be one that x is beyond or on
  logical function agrees(mesh, x, found, expected)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: x(mesh%dim)
    type(found_t), intent(in) :: found
    integer, intent(in) :: expected
    agrees = .false.
    if (expected > 0) then
      agrees = found%element == expected .and. found%how /= found_outside .and. found%side == 0
      return
    end if
    if (found%how /= found_outside .or. found%side < 1) return
    if (mesh%side_element(found%side) /= found%element) return
    agrees = side_value(mesh, found%element, mesh%side_number(found%side), x) <= 0.0_wp
  end function agrees

  !> The owner by its definition: a look at all elements whose box, somewhat wider, has x
  integer function by_brute_force(mesh, x) result(owner)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: x(mesh%dim)
    real(wp) :: value(most_sides), best
    integer :: e, k
    owner = 0
    best = -slack
    do e = 1, mesh%elements
      if (any(abs(x - mesh%x(:, mesh%node(1, e))) > 4.0_wp)) cycle ! no element is larger
      k = kind_corners(mesh%kind(e))
      if (any(x < minval(mesh%x(:, mesh%node(:k, e)), 2) - 0.5_wp) .or. any(x > maxval(mesh%x(:, mesh%node(:k, e)), 2) + 0.5_wp)) cycle
      call side_values(mesh, e, x, value)
      if (minval(value) >= 0.0_wp) then
        owner = e
        return
      end if
      if (minval(value) > best .or. (owner == 0 .and. minval(value) >= best)) then
        best = minval(value)
        owner = e
      end if
    end do
  end function by_brute_force

  !> A mesh without the elements whose first node is in a box
  function without(made, low, high) result(mesh)
    type(mesh_t), intent(in) :: made
    real(wp), intent(in) :: low(:), high(:)
    type(mesh_t) :: mesh
    integer :: kept(made%elements)
    integer :: e, n
    n = 0
    do e = 1, made%elements
      if (all(made%x(:, made%node(1, e)) > low .and. made%x(:, made%node(1, e)) < high)) cycle
      n = n + 1
      kept(n) = e
    end do
    mesh = made
    mesh%elements = n
    mesh%kind = made%kind(kept(:n))
    mesh%node = made%node(:, kept(:n))
    mesh%element_in_file = made%element_in_file(kept(:n))
  end function without

  !> A place in and around the box of the mesh
  function place_about(mesh, beyond) result(x)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: beyond !! by this share of its size
    real(wp) :: x(mesh%dim)
    real(wp) :: low(mesh%dim), high(mesh%dim)
    integer :: d
    low = minval(mesh%x, 2)
    high = maxval(mesh%x, 2)
    do d = 1, mesh%dim
      x(d) = low(d) + (high(d) - low(d))*((1.0_wp + 2.0_wp*beyond)*real(random_number_of(random), wp) - beyond)
    end do
  end function place_about

  !> A random place that lies in an element if its sides are flat: a mean of its corners with random shares
  function place_in(mesh, e) result(x)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp) :: x(mesh%dim)
    real(wp) :: share(8)
    integer :: k, n
    n = kind_corners(mesh%kind(e))
    do k = 1, n
      share(k) = -log(real(random_number_of(random), wp)) ! uniform in simplices
    end do
    x = 0.0_wp
    do k = 1, n
      x = x + share(k)/sum(share(:n))*mesh%x(:, mesh%node(k, e))
    end do
  end function place_in

  !> A random place on a side, an edge of it, or at one of its ends
  function place_on_side(mesh, e) result(x)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp) :: x(mesh%dim)
    x = place_on(mesh, e, 1 + int(kind_sides(mesh%kind(e))*random_number_of(random)), .false.)
  end function place_on_side

  function place_on(mesh, e, s, anywhere) result(x)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e, s
    logical, intent(in) :: anywhere !! not at its ends
    real(wp) :: x(mesh%dim)
    integer :: node(most_side_corners), n, choice, k
    real(wp) :: t
    node = side_nodes(mesh, e, s)
    n = side_corners(mesh%kind(e))
    choice = int(3.0_dp*random_number_of(random))
    t = real(random_number_of(random), wp)
    if (modulo(choice, 2) == 0) t = real(nint(16.0_wp*t), wp)/16.0_wp
    if (anywhere) choice = 2
    x = mesh%x(:, node(1))
    if (choice == 0 .or. n == 1) then ! a vertex
      x = mesh%x(:, node(1 + int(n*random_number_of(random))))
    else if (mesh%dim == 2) then
      k = kind_corners(mesh%kind(e)) + s
      x = (1.0_wp - t)*mesh%x(:, node(1)) + t*mesh%x(:, node(2))
      if (size(mesh%node, 1) >= k .and. any(mesh%kind(e) == [3, 5, 6])) x = x + &
        4.0_wp*t*(1.0_wp - t)*(mesh%x(:, mesh%node(k, e)) - 0.5_wp*(mesh%x(:, node(1)) + mesh%x(:, node(2))))
    else if (choice == 1) then ! an edge
      k = 1 + int(n*random_number_of(random))
      x = (1.0_wp - t)*mesh%x(:, node(k)) + t*mesh%x(:, node(1 + modulo(k, n)))
    else ! a triangle of the face
      k = minloc(node(:n), dim=1)
      node(:n) = cshift(node(:n), k - 1)
      k = 2 + int((n - 2)*random_number_of(random))
      x = mesh%x(:, node(k)) + t*(mesh%x(:, node(k + 1)) - mesh%x(:, node(k)))
      x = x + real(random_number_of(random), wp)*(mesh%x(:, node(1)) - x)
    end if
  end function place_on

  integer function some_element(mesh) result(e)
    type(mesh_t), intent(in) :: mesh
    e = 1 + int(mesh%elements*random_number_of(random))
  end function some_element

  !> An element that shares a vertex with e
  integer function some_neighbour(mesh, e) result(other)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    integer :: node, n
    node = mesh%node(1 + int(kind_corners(mesh%kind(e))*random_number_of(random)), e)
    n = mesh%vertex_first(node + 1) - mesh%vertex_first(node)
    other = mesh%vertex_element(mesh%vertex_first(node) + int(n*random_number_of(random)))
  end function some_neighbour

  !> A random unit vector
  function direction(dim) result(v)
    integer, intent(in) :: dim
    real(wp) :: v(dim)
    integer :: d
    do
      do d = 1, dim
        v(d) = 2.0_wp*real(random_number_of(random), wp) - 1.0_wp
      end do
      if (sum(v**2) <= 1.0_wp .and. sum(v**2) > 0.01_wp) exit
    end do
    v = v/norm2(v)
  end function direction

  !> The numbers 1 to n in random order
  function shuffled(n) result(order)
    integer, intent(in) :: n
    integer :: order(n)
    integer :: i, j, swap
    order = [(i, i=1, n)]
    do i = n, 2, -1
      j = 1 + int(i*random_number_of(random))
      swap = order(i)
      order(i) = order(j)
      order(j) = swap
    end do
  end function shuffled

end program test_search
