!> B-splines: the conditions every basis must satisfy, against the definition by Cox and de Boor, and the closed forms of the
!> end cells
program test_splines
  use gimp_kinds, only: wp
  use gimp_grid, only: grid_t, make_grid, low_side_node, high_side_node
  use gimp_splines, only: spline_t, make_spline, spline_reach, spline_weights, node_place
  use gimp_basis, only: weight_list_t, make_weight_list, take_moments, list_inertia, axis_weights
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: round_off = epsilon(1.0_wp)
  integer :: seed = 815, degree, cells

  call begin_suite("splines")
  do degree = 2, 3
    do cells = 1, 8
      call test_axis(degree, .true., cells)
    end do
    call test_axis(degree, .false., 5)
    call test_list(degree, .true.)
    call test_list(degree, .false.)
    call test_other_block(degree)
  end do
  call test_closed_forms()
  call test_quadratic_is_gimp()
  call test_inertia()
  call test_sides()
  call end_suite()

contains

  !> Reproducible numbers in (0, 1)
  real(wp) function number()
    seed = modulo(16807*modulo(seed, 127773) - 2836*(seed/127773), 2147483647)
    number = seed/2147483647.0_wp
  end function number

  type(spline_t) function spline_of(degree, open, cells, at) result(spline)
    integer, intent(in) :: degree, cells, at
    logical, intent(in) :: open
    type(grid_t) :: grid
    grid = make_grid(3, [0.0_wp, 0.0_wp, 0.0_wp], real([cells, cells, cells], wp), 1.0_wp)
    if (open) grid%open_degree = degree
    spline = make_spline(degree, grid, [at, at, at])
  end function spline_of

  !> Places: anywhere, on knots, half-way between them, and right on both sides of the box
  real(wp) function some_place(trial, open, cells) result(x)
    integer, intent(in) :: trial, cells
    logical, intent(in) :: open
    x = number()*cells
    if (modulo(trial, 5) == 0) x = anint(x)
    if (modulo(trial, 7) == 0) x = 0.5_wp*anint(2.0_wp*x)
    if (modulo(trial, 11) == 0) x = cells
    if (modulo(trial, 13) == 0) x = 0.0_wp
    if (.not. open) x = 3.0_wp*x - cells ! outside too
  end function some_place

  !> Sum S = 1, sum G = 0, sum x_i S = x, sum x_i G = 1, S >= 0; and each S, G is that of the definition. Sums of up to four
  !> products of size up to 3 (slopes at an open end) and 24 (places outside a box of 8): 1e-13 is 20 times their round-off
  subroutine test_axis(degree, open, cells)
    integer, intent(in) :: degree, cells
    logical, intent(in) :: open
    type(spline_t) :: spline
    real(wp) :: x, s(6), g(6), worst(5), place, value, slope
    integer :: trial, first, n, i
    character(len=:), allocatable :: which
    which = ", degree "//text_of(degree)//", "//text_of(cells)//" cells"
    if (open) which = which//", open knots"
    spline = spline_of(degree, open, cells, 0)
    worst = 0.0_wp
    do trial = 1, 300
      x = some_place(trial, open, cells)
      call spline_weights(spline, 1, x, first, n, s, g)
      if (n /= degree + 1 .or. minval(s) < 0.0_wp) worst(1) = huge(1.0_wp)
      if (open .and. (first < -1 .or. first + n - 1 > cells + degree - 2)) worst(1) = huge(1.0_wp)
      worst(1) = max(worst(1), abs(sum(s) - 1.0_wp))
      worst(2) = max(worst(2), abs(sum(g)))
      value = 0.0_wp
      slope = 0.0_wp
      do i = 1, n
        place = node_place(spline, 1, first + i - 1)
        value = value + s(i)*(place - x)
        slope = slope + g(i)*(place - x)
      end do
      worst(3) = max(worst(3), abs(value))
      worst(4) = max(worst(4), abs(slope - 1.0_wp))
      do i = -8, 2*cells + 12 ! also functions that are not in the list: they must be zero
        value = by_definition(degree, open, cells, i, x)
        slope = slope_by_definition(degree, open, cells, i, x)
        if (i >= first .and. i < first + n) then
          value = value - s(i - first + 1)
          slope = slope - g(i - first + 1)
        end if
        worst(5) = max(worst(5), abs(value), abs(slope))
      end do
    end do
    call check(worst(1), 0.0_wp, 1.0e-13_wp, "weights sum to one, none is negative or outside"//which)
    call check(worst(2), 0.0_wp, 1.0e-13_wp, "gradients sum to zero"//which)
    call check(worst(3), 0.0_wp, 1.0e-13_wp, "Greville abscissae give a linear field"//which)
    call check(worst(4), 0.0_wp, 1.0e-13_wp, "and its gradient"//which)
    call check(worst(5), 0.0_wp, 1.0e-13_wp, "the definition by Cox and de Boor"//which)
  end subroutine test_axis

  !> Knot j of the function of a node, j = 0 ... degree + 1
  pure real(wp) function knot(degree, open, cells, node, j)
    integer, intent(in) :: degree, cells, node, j
    logical, intent(in) :: open
    knot = node + j - 1
    if (degree == 2 .and. .not. open) knot = knot - 0.5_wp ! centred at the node
    if (degree == 3) knot = knot - 1.0_wp
    if (open) knot = min(max(knot, 0.0_wp), real(cells, wp))
  end function knot

  !> N by the recursion over degrees, 0/0 = 0; spans are half open but for the last one of the box
  pure recursive real(wp) function basis_function(degree, p, open, cells, node, j, x) result(n)
    integer, intent(in) :: degree, p, cells, node, j !! N of degree p on knots j ... j + p + 1 of the node
    logical, intent(in) :: open
    real(wp), intent(in) :: x
    real(wp) :: a, b
    n = 0.0_wp
    if (p == 0) then
      a = knot(degree, open, cells, node, j)
      b = knot(degree, open, cells, node, j + 1)
      if (x >= a .and. (x < b .or. (open .and. x <= b .and. b >= cells)) .and. b > a) n = 1.0_wp
      return
    end if
    a = knot(degree, open, cells, node, j + p) - knot(degree, open, cells, node, j)
    b = knot(degree, open, cells, node, j + p + 1) - knot(degree, open, cells, node, j + 1)
    if (a > 0.0_wp) n = n + (x - knot(degree, open, cells, node, j))/a*basis_function(degree, p - 1, open, cells, node, j, x)
    if (b > 0.0_wp) n = n + (knot(degree, open, cells, node, j + p + 1) - x)/b &
                      *basis_function(degree, p - 1, open, cells, node, j + 1, x)
  end function basis_function

  pure real(wp) function by_definition(degree, open, cells, node, x)
    integer, intent(in) :: degree, cells, node
    logical, intent(in) :: open
    real(wp), intent(in) :: x
    by_definition = basis_function(degree, degree, open, cells, node, 0, x)
  end function by_definition

  pure real(wp) function slope_by_definition(degree, open, cells, node, x) result(g)
    integer, intent(in) :: degree, cells, node
    logical, intent(in) :: open
    real(wp), intent(in) :: x
    real(wp) :: a, b
    g = 0.0_wp
    a = knot(degree, open, cells, node, degree) - knot(degree, open, cells, node, 0)
    b = knot(degree, open, cells, node, degree + 1) - knot(degree, open, cells, node, 1)
    if (a > 0.0_wp) g = g + degree/a*basis_function(degree, degree - 1, open, cells, node, 0, x)
    if (b > 0.0_wp) g = g - degree/b*basis_function(degree, degree - 1, open, cells, node, 1, x)
  end function slope_by_definition

  !> The lists of two and three dimensions, with moments about the place
  subroutine test_list(degree, open)
    integer, intent(in) :: degree
    logical, intent(in) :: open
    type(weight_list_t) :: list
    type(spline_t) :: spline
    real(wp) :: x(3), half(3), unit(3, 3), worst(3), inertia(3), place(3)
    integer :: dim, trial, i, j
    half = 0.0_wp
    worst = 0.0_wp
    spline = spline_of(degree, open, 4, 0)
    do dim = 2, 3
      do trial = 1, 200
        x = 0.0_wp
        do j = 1, dim
          x(j) = some_place(trial + j, open, 4)
        end do
        call make_weight_list(dim, x, half, spline, list)
        if (list%n /= (degree + 1)**dim) worst = huge(1.0_wp)
        unit = 0.0_wp
        do i = 1, list%n
          place(:dim) = [(node_place(spline, j, list%node(j, i)), j=1, dim)] - x(:dim)
          do j = 1, dim
            unit(:dim, j) = unit(:dim, j) + place(:dim)*list%g(j, i)
          end do
        end do
        do j = 1, dim
          unit(j, j) = unit(j, j) - 1.0_wp
        end do
        worst(1) = max(worst(1), abs(sum(list%s(:list%n)) - 1.0_wp))
        worst(2) = max(worst(2), maxval(abs(unit(:dim, :dim))))
        call take_moments(dim, x, spline, list)
        inertia = list_inertia(dim, x, half, spline)
        do j = 1, dim
          worst(3) = max(worst(3), abs(sum(list%g(j, :list%n))))
          inertia(j) = inertia(j) - sum([(list%g(j, i)*(node_place(spline, j, list%node(j, i)) - x(j)), i=1, list%n)])
          worst(3) = max(worst(3), abs(inertia(j)))
        end do
      end do
    end do
    call check(worst(1), 0.0_wp, 1.0e-13_wp, "weights of a list sum to one, degree "//text_of(degree))
    call check(worst(2), 0.0_wp, 1.0e-13_wp, "gradients of linear fields by a list, degree "//text_of(degree))
    call check(worst(3), 0.0_wp, 1.0e-13_wp, "moments sum to zero and give the inertia, degree "//text_of(degree))
  end subroutine test_list

  !> Another block sees the same weights on shifted nodes
  subroutine test_other_block(degree)
    integer, intent(in) :: degree
    type(spline_t) :: near, far
    real(wp) :: x, s(6), g(6), s0(6), g0(6), worst
    integer :: trial, first, n, first0, n0
    near = spline_of(degree, .true., 9, 0)
    far = spline_of(degree, .true., 9, 2) ! blocks of 4 nodes
    worst = 0.0_wp
    do trial = 1, 100
      x = some_place(trial, .true., 9)
      call spline_weights(near, 2, x, first, n, s, g)
      call spline_weights(far, 2, x - 8.0_wp, first0, n0, s0, g0)
      if (first0 /= first - 8) worst = huge(1.0_wp)
      worst = max(worst, maxval(abs(s - s0)), maxval(abs(g - g0)))
    end do
    call check(worst, 0.0_wp, 100*round_off, "shifted by two blocks, degree "//text_of(degree)) ! x - 8 rounds by 4 epsilon
  end subroutine test_other_block

  !> The polynomials of the first cells and of the cells inside (Steffen, Kirby & Berzins 2008), t from the start of the cell
  subroutine test_closed_forms()
    real(wp) :: t, s(6), g(6), u
    integer :: k, first, n
    type(spline_t) :: spline
    do k = 0, 15
      t = k/16.0_wp
      u = 1.0_wp - t
      spline = spline_of(2, .true., 6, 0)
      call spline_weights(spline, 1, t, first, n, s, g)
      call check(s(:3), [u**2, (4*t - 3*t**2)/2, t**2/2], 8*round_off, "quadratic, first cell")
      call check(g(:3), [-2*u, 2 - 3*t, t], 16*round_off, "quadratic, slopes of the first cell")
      call spline_weights(spline, 1, 2 + t, first, n, s, g)
      call check(s(:3), [u**2/2, (1 + 2*t - 2*t**2)/2, t**2/2], 8*round_off, "quadratic, inside")
      call spline_weights(spline, 1, 5 + t, first, n, s, g)
      call check(s(:3), [u**2/2, (4*u - 3*u**2)/2, t**2], 8*round_off, "quadratic, last cell")
      spline = spline_of(3, .true., 6, 0)
      call spline_weights(spline, 1, t, first, n, s, g)
      call check(s(:4), [u**3, (7*t**3 - 18*t**2 + 12*t)/4, (-11*t**3 + 18*t**2)/12, t**3/6], 16*round_off, "cubic, first cell")
      call spline_weights(spline, 1, 1 + t, first, n, s, g)
      call check(s(:4), [u**3/4, (7*t**3 - 15*t**2 + 3*t + 7)/12, (-3*t**3 + 3*t**2 + 3*t + 1)/6, t**3/6], 16*round_off, &
                 "cubic, second cell")
      call spline_weights(spline, 1, 2 + t, first, n, s, g)
      call check(s(:4), [u**3/6, (3*t**3 - 6*t**2 + 4)/6, (-3*t**3 + 3*t**2 + 3*t + 1)/6, t**3/6], 16*round_off, "cubic, inside")
    end do
    spline = spline_of(2, .true., 1, 0)
    call spline_weights(spline, 1, 0.25_wp, first, n, s, g)
    call check(s(:3), [0.5625_wp, 0.375_wp, 0.0625_wp], 4*round_off, "one cell: the polynomials of Bernstein")
  end subroutine test_closed_forms

  !> The quadratic ghost form is GIMP with a half length of half a cell
  subroutine test_quadratic_is_gimp()
    real(wp) :: x, s(6), g(6), s0(6), g0(6), worst
    integer :: trial, first, n, first0, n0
    worst = 0.0_wp
    do trial = 1, 200
      x = 10*number() - 5
      call spline_weights(spline_of(2, .false., 5, 0), 1, x, first, n, s, g)
      call axis_weights(x, 0.5_wp, first0, n0, s0, g0)
      worst = max(worst, maxval(abs(s(:3) - s0(:3))), maxval(abs(g(:3) - g0(:3))))
      if (first /= first0) worst = huge(1.0_wp)
    end do
    call check(worst, 0.0_wp, 32*round_off, "the quadratic spline is GIMP with a domain as wide as a cell")
  end subroutine test_quadratic_is_gimp

  !> Inertia: 1/4 for the uniform quadratic, 1/3 for the uniform cubic, wherever the particle is; zero on an open end
  subroutine test_inertia()
    real(wp) :: x(1), half(1), d(3)
    integer :: trial
    half = 0.0_wp
    do trial = 1, 50
      x = 10*number()
      d = list_inertia(1, x, half, spline_of(2, .false., 5, 0))
      call check(d(1), 0.25_wp, 32*round_off, "inertia of the quadratic")
      d = list_inertia(1, x, half, spline_of(3, .false., 5, 0))
      call check(d(1), 1.0_wp/3.0_wp, 32*round_off, "inertia of the cubic")
    end do
    x = 0.0_wp
    d = list_inertia(1, x, half, spline_of(3, .true., 5, 0))
    call check(d(1), 0.0_wp, 0.0_wp, "a particle on an open end gives all to one function")
  end subroutine test_inertia

  !> First and last function stand on the sides and are one there; the grid knows their nodes
  subroutine test_sides()
    type(grid_t) :: grid
    type(spline_t) :: spline
    real(wp) :: s(6), g(6)
    integer :: degree, first, n
    grid = make_grid(1, [0.0_wp], [7.0_wp], 1.0_wp)
    call check_true(low_side_node(grid) == 0 .and. high_side_node(grid, 1) == 7, "nodes on the sides of a plain grid")
    do degree = 2, 3
      grid%open_degree = degree
      spline = make_spline(degree, grid, [0, 0, 0])
      call check(node_place(spline, 1, low_side_node(grid)), 0.0_wp, 0.0_wp, "the first function stands on the side")
      call check(node_place(spline, 1, high_side_node(grid, 1)), 7.0_wp, 0.0_wp, "and so does the last one")
      call check(high_side_node(grid, 1) - low_side_node(grid) + 1, 7 + degree, "as many functions as cells plus degree")
      call spline_weights(spline, 1, 7.0_wp, first, n, s, g)
      call check(first + n - 1, high_side_node(grid, 1), "the last function is the last of the list")
      call check(s(n), 1.0_wp, round_off, "and is one on the side")
      call spline_weights(spline, 1, 0.0_wp, first, n, s, g)
      call check(first, low_side_node(grid), "the first function is the first of the list")
      call check(s(1), 1.0_wp, round_off, "and is one on its side")
    end do
  end subroutine test_sides

end program test_splines
