!> gimp_search_cost.x [queries [points]]: which stage of the search finds particles after steps of several sizes, how many elements it tests,
!> and how long it takes to locate many points at the start. Tables in Markdown, as in docs/search.md. Times are those of one core
program gimp_search_cost
  use gimp_kinds, only: wp, dp
  use gimp_mesh, only: mesh_t, kind_corners, kind_nodes
  use gimp_elements, only: element_volume
  use gimp_mesh_connect, only: connect_mesh
  use gimp_search, only: locator_t, found_t, make_locator, find_element, find_anywhere, owns, found_here, found_outside, rule_velocity, &
    rule_component
  use gimp_made_meshes, only: made_triangles, made_quads, made_hybrid, made_tetrahedra, made_hexahedra, made_quadratic, turn_mesh, &
    random_t, random_number_of
  implicit none(type, external)
  type(random_t) :: random
  integer :: queries = 100000, points = 1000000

  call read_arguments()
  print "(a,i0,a)", "### Steps: ", queries, " particles each"
  print "(a)", ""
  print "(a)", "| mesh | rule | step | here % | vertices % | walk % | rings % | buckets % | outside % | tests per query "// &
    "| P(leave) | 1 + 1.2 P | ns per query |"
  print "(a)", "|---|---|---|---|---|---|---|---|---|---|---|---|---|"
  call tell_steps("quads", made_quads([40, 40]))
  call tell_steps("quads, distorted 30 %", made_quads([40, 40], 0.3_dp))
  call tell_steps("quads turned by 45 degrees", turned(made_quads([40, 40])))
  call tell_steps("triangles", made_triangles([40, 40]))
  call tell_steps("triangles, distorted 25 %", made_triangles([40, 40], 0.25_dp))
  call tell_steps("triangles and quads, distorted 25 %", made_hybrid([40, 40], 0.25_dp))
  call tell_steps("quad9 and triangle6, curved", made_quadratic(made_hybrid([40, 40], 0.15_dp), .true., 0.08_dp))
  call tell_steps("tetrahedra", made_tetrahedra([16, 16, 16]))
  call tell_steps("tetrahedra, distorted 20 %", made_tetrahedra([16, 16, 16], 0.2_dp))
  call tell_steps("hexahedra", made_hexahedra([20, 20, 20]))
  call tell_steps("hexahedra, distorted 30 %", made_hexahedra([20, 20, 20], 0.3_dp))
  print "(a)", ""
  print "(a,i0,a)", "### Start: ", points, " points on a lattice, along x first"
  print "(a)", ""
  print "(a)", "| mesh | elements | make_locator s | buckets alone s | tests per point | last element first, then buckets s | "// &
    "tests per point | ratio |"
  print "(a)", "|---|---|---|---|---|---|---|---|"
  call tell_start("quads", made_quads([500, 500]))
  call tell_start("quads, distorted 30 %", made_quads([500, 500], 0.3_dp))
  call tell_start("triangles, distorted 25 %", made_triangles([350, 350], 0.25_dp))
  call tell_start("quad9 and triangle6, curved", made_quadratic(made_hybrid([400, 400], 0.15_dp), .true., 0.08_dp))
  call tell_start("tetrahedra, distorted 20 %", made_tetrahedra([35, 35, 35], 0.2_dp))
  call tell_start("hexahedra, distorted 30 %", made_hexahedra([50, 50, 50], 0.3_dp))

contains

  subroutine read_arguments()
    character(len=32) :: word
    integer :: status, k, n
    do k = 1, command_argument_count()
      call get_command_argument(k, word)
      read (word, *, iostat=status) n
      if (status /= 0 .or. k > 2) stop "usage: gimp_search_cost.x [queries of each kind [points at the start]]", quiet=.true.
      if (k == 1) queries = n
      if (k == 2) points = n
    end do
  end subroutine read_arguments

  function turned(made) result(mesh)
    type(mesh_t), intent(in) :: made
    type(mesh_t) :: mesh
    mesh = made
    call turn_mesh(mesh, 45.0_dp)
  end function turned

  !> Lines of the table of steps for one mesh
  subroutine tell_steps(name, made)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: made
    real(wp), parameter :: steps(6) = [0.1_wp, 0.25_wp, 0.5_wp, 1.0_wp, 3.0_wp, 30.0_wp]
    type(mesh_t) :: mesh
    type(locator_t) :: locator
    real(wp) :: cell
    integer :: k, e
    mesh = made
    call connect_mesh(mesh)
    call make_locator(mesh, locator)
    cell = 0.0_wp
    do e = 1, mesh%elements
      cell = cell + element_volume(mesh%kind(e), mesh%x(:, mesh%node(:kind_nodes(mesh%kind(e)), e)))/mesh%elements
    end do
    cell = cell**(1.0_wp/mesh%dim)
    do k = 1, size(steps)
      call tell_step(name, mesh, locator, rule_velocity, steps(k), cell)
    end do
    call tell_step(name, mesh, locator, rule_component, steps(1), cell)
    call tell_step(name, mesh, locator, rule_component, steps(3), cell)
  end subroutine tell_steps

  !> Steps of random direction and random length up to `longest`, from random places in random elements
  subroutine tell_step(name, mesh, locator, rule, longest, cell)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: rule
    real(wp), intent(in) :: longest !! in sizes of elements
    real(wp), intent(in) :: cell !! the mean size of elements: root of the mean area, cube root of the mean volume
    type(found_t) :: found
    real(wp), allocatable :: x(:, :), v(:, :)
    integer, allocatable :: start(:)
    integer :: i, how(found_outside), visits
    real(dp) :: began, ended, leave
    allocate (x(mesh%dim, queries), v(mesh%dim, queries), start(queries))
    do i = 1, queries
      start(i) = 1 + int(mesh%elements*random_number_of(random))
      v(:, i) = real(random_number_of(random), wp)*longest*cell*direction(mesh%dim)
      do
        x(:, i) = place_in(mesh, start(i))
        if (owns(mesh, start(i), x(:, i))) exit ! sides may be curved
      end do
      x(:, i) = x(:, i) + v(:, i)
    end do
    how = 0
    visits = 0
    call cpu_time(began)
    do i = 1, queries
      call find_element(mesh, locator, rule, x(:, i), v(:, i), start(i), found)
      how(found%how) = how(found%how) + 1
      visits = visits + found%visits
    end do
    call cpu_time(ended)
    leave = 1.0_dp - real(how(found_here), dp)/queries
    print "(4a,f5.2,6(a,f6.2),a,f7.3,a,f6.3,a,f6.3,a,i0,a)", "| ", name, merge(" | velocity  ", " | components", rule == rule_velocity), &
      " | ", longest, (" | ", 100.0_dp*how(i)/queries, i=1, found_outside), " | ", real(visits, dp)/queries, " | ", leave, " | ", &
      1.0_dp + 1.2_dp*leave, " | ", nint(1.0e9_dp*(ended - began)/queries), " |"
  end subroutine tell_step

  !> A line of the table of starts
  subroutine tell_start(name, made)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: made
    type(mesh_t) :: mesh
    type(locator_t) :: locator
    type(found_t) :: found
    real(wp), allocatable :: x(:, :)
    integer, allocatable :: element(:)
    integer :: i, last, visits(2)
    real(dp) :: clock(4)
    mesh = made
    call connect_mesh(mesh)
    call lattice(mesh, x)
    allocate (element(size(x, 2)))
    visits = 0
    call cpu_time(clock(1))
    call make_locator(mesh, locator)
    call cpu_time(clock(2))
    do i = 1, size(x, 2)
      call find_anywhere(mesh, locator, x(:, i), found)
      visits(1) = visits(1) + found%visits
      element(i) = found%element
    end do
    call cpu_time(clock(3))
    last = 0
    do i = 1, size(x, 2)
      call find_anywhere(mesh, locator, x(:, i), found, hint=last)
      visits(2) = visits(2) + found%visits
      last = found%element
      if (last /= element(i)) stop "the two searches disagree"
    end do
    call cpu_time(clock(4))
    print "(3a,i0,2(a,f6.3),a,f6.2,a,f6.3,a,f6.2,a,f5.2,a)", "| ", name, " | ", mesh%elements, " | ", clock(2) - clock(1), " | ", &
      clock(3) - clock(2), " | ", real(visits(1), dp)/size(x, 2), " | ", clock(4) - clock(3), " | ", real(visits(2), dp)/size(x, 2), &
      " | ", (clock(4) - clock(3))/(clock(3) - clock(2)), " |"
  end subroutine tell_start

  !> About `points` points, evenly over the box of the mesh, along x first
  subroutine lattice(mesh, x)
    type(mesh_t), intent(in) :: mesh
    real(wp), allocatable, intent(out) :: x(:, :)
    real(wp) :: low(mesh%dim), edge(mesh%dim)
    integer :: n(mesh%dim), i, d, rest
    low = minval(mesh%x, 2)
    edge = maxval(mesh%x, 2) - low
    n = nint(edge*(points/product(edge))**(1.0_wp/mesh%dim))
    allocate (x(mesh%dim, product(n)))
    do i = 1, product(n)
      rest = i - 1
      do d = 1, mesh%dim
        x(d, i) = low(d) + edge(d)*(modulo(rest, n(d)) + 0.5_wp)/n(d)
        rest = rest/n(d)
      end do
    end do
  end subroutine lattice

  !> A random place in an element, evenly distributed in simplices and parallelepipeds
  function place_in(mesh, e) result(x)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp) :: x(mesh%dim)
    real(wp) :: share(8), t(3)
    integer :: k, n
    n = kind_corners(mesh%kind(e))
    if (n == mesh%dim + 1) then
      do k = 1, n
        share(k) = -log(real(random_number_of(random), wp))
      end do
      share(:n) = share(:n)/sum(share(:n))
    else
      do k = 1, 3
        t(k) = real(random_number_of(random), wp)
      end do
      share(:4) = [(1 - t(1))*(1 - t(2)), t(1)*(1 - t(2)), t(1)*t(2), (1 - t(1))*t(2)]
      share(5:8) = share(:4)*t(3)
      if (n == 8) share(:4) = share(:4)*(1 - t(3))
    end if
    x = 0.0_wp
    do k = 1, n
      x = x + share(k)*mesh%x(:, mesh%node(k, e))
    end do
  end function place_in

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

end program gimp_search_cost
