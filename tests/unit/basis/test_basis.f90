!> Weight lists: the four conditions every basis must satisfy, and the closed forms they reduce to
program test_basis
  use gimp_kinds, only: wp
  use gimp_splines, only: spline_t
  use gimp_basis, only: weight_list_t, make_weight_list, axis_weights, basis_of_word, basis_words, support_width, &
    basis_linear, basis_ugimp, basis_cpgimp, most_nodes, longest_half
  use gimp_text, only: text_of, count_words, nth_word
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: round_off = epsilon(1.0_wp)
  integer :: seed = 4711

  call begin_suite("basis")
  call test_words()
  call test_conditions(1)
  call test_conditions(2)
  call test_conditions(3)
  call test_closed_form()
  call test_quadratic_spline()
  call test_point_limit()
  call test_on_a_node()
  call test_convolution()
  call test_symmetry()
  call end_suite()

contains

  !> Reproducible numbers in (0, 1)
  subroutine random_number_of(x)
    real(wp), intent(out) :: x
    seed = modulo(16807*modulo(seed, 127773) - 2836*(seed/127773), 2147483647)
    x = seed/2147483647.0_wp
  end subroutine random_number_of

  subroutine test_words()
    integer :: k
    do k = 1, count_words(basis_words)
      call check(basis_of_word(nth_word(basis_words, k)), k, "word "//text_of(k)//" names its basis")
    end do
    call check(basis_of_word("quartic"), 0, "an unknown word names none")
    call check(support_width(basis_linear), 2, "tents touch two nodes an axis")
    call check(support_width(basis_ugimp), 3, "GIMP touches three")
    call check(support_width(basis_cpgimp), 3, "cpGIMP touches three while narrow")
  end subroutine test_words

  !> sum S = 1, sum G = 0, sum x_i S = x, sum x_i (x) G = I for random places (also negative and far out) and half lengths of
  !> 0, and 0.001 to 2 by equal chances per decade. The exact form divides a difference of integrals of size 1 by 2 l, so
  !> round-off grows as epsilon/l: with l >= 0.001 and up to 216 nodes 2000 epsilon bounds it (largest seen: 400).
  subroutine test_conditions(dim)
    integer, intent(in) :: dim
    real(wp), parameter :: tolerance = 2000*round_off
    type(weight_list_t) :: list
    real(wp) :: x(3), half(3), u, worst(4), moment(3), unit(3, 3)
    integer :: trial, k, i, j, most
    worst = 0.0_wp
    most = 0
    x = 0.0_wp
    half = 0.0_wp
    do trial = 1, 3000
      do k = 1, dim
        call random_number_of(u)
        x(k) = 20*u - 10
        call random_number_of(u)
        half(k) = 1.0e-3_wp*2000.0_wp**u
        if (modulo(trial, 5) == 0) half(k) = 0.0_wp
        if (modulo(trial, 7) == 0) half(k) = longest_half
      end do
      call make_weight_list(dim, x, half, spline_t(), list)
      most = max(most, list%n)
      moment = 0.0_wp
      unit = 0.0_wp
      do i = 1, list%n
        moment = moment + (list%node(:, i) - x)*list%s(i) ! about x: absolute coordinates would only measure their own size
        do j = 1, dim
          unit(:dim, j) = unit(:dim, j) + (list%node(:dim, i) - x(:dim))*list%g(j, i)
        end do
      end do
      do j = 1, dim
        unit(j, j) = unit(j, j) - 1.0_wp
      end do
      worst(1) = max(worst(1), abs(sum(list%s(:list%n)) - 1.0_wp))
      do j = 1, dim
        worst(2) = max(worst(2), abs(sum(list%g(j, :list%n))))
      end do
      worst(3) = max(worst(3), maxval(abs(moment(:dim))))
      worst(4) = max(worst(4), maxval(abs(unit(:dim, :dim))))
      if (minval(list%s(:list%n)) < -100*round_off) worst(1) = huge(1.0_wp)
    end do
    call check(worst(1), 0.0_wp, tolerance, "weights sum to one and none is negative, dimension "//text_of(dim))
    call check(worst(2), 0.0_wp, tolerance, "gradients sum to zero, dimension "//text_of(dim))
    call check(worst(3), 0.0_wp, tolerance, "a linear field is reproduced, dimension "//text_of(dim))
    call check(worst(4), 0.0_wp, tolerance, "its gradient is exact, dimension "//text_of(dim))
    call check_true(most <= most_nodes, "a list never holds more nodes than it has room for")
    call check_true(most >= 5**dim, "the longest domains were tried")
  end subroutine test_conditions

  !> The piecewise form for l <= 1/2 (Bardenhagen & Kober 2004; distances in cells)
  pure subroutine piecewise(d, l, s, g)
    real(wp), intent(in) :: d, l
    real(wp), intent(out) :: s, g
    real(wp) :: a
    a = abs(d)
    if (a < l) then
      s = 1.0_wp - (d*d + l*l)/(2.0_wp*l)
      g = -d/l
    else if (a <= 1.0_wp - l) then
      s = 1.0_wp - a
      g = -sign(1.0_wp, d)
    else if (a < 1.0_wp + l) then
      s = (1.0_wp + l - a)**2/(4.0_wp*l)
      g = -sign(1.0_wp, d)*(1.0_wp + l - a)/(2.0_wp*l)
    else
      s = 0.0_wp
      g = 0.0_wp
    end if
  end subroutine piecewise

  !> Random places, l from 0.05 to 1/2; round-off of the exact form is a few epsilon/l, l >= 0.05
  subroutine test_closed_form()
    real(wp) :: x, l, s(6), g(6), s0, g0, u, worst_s, worst_g
    integer :: trial, first, n, k
    worst_s = 0.0_wp
    worst_g = 0.0_wp
    do trial = 1, 4000
      call random_number_of(u)
      x = 6*u - 3
      call random_number_of(u)
      l = 0.05_wp + 0.45_wp*u
      if (modulo(trial, 4) == 0) l = 0.5_wp
      call axis_weights(x, l, first, n, s, g)
      do k = -6, 6 ! also nodes outside the list: their closed form must be zero
        call piecewise(x - k, l, s0, g0)
        if (k >= first .and. k < first + n) then
          worst_s = max(worst_s, abs(s(k - first + 1) - s0))
          worst_g = max(worst_g, abs(g(k - first + 1) - g0))
        else
          worst_s = max(worst_s, abs(s0))
          worst_g = max(worst_g, abs(g0))
        end if
      end do
    end do
    call check(worst_s, 0.0_wp, 64*round_off, "weights equal the closed form of uGIMP")
    call check(worst_g, 0.0_wp, 64*round_off, "gradients equal the closed form of uGIMP")
  end subroutine test_closed_form

  !> l = h/2 makes the quadratic B-spline: 3/4 - d^2 for d < 1/2, (3/2 - d)^2/2 for d < 3/2
  subroutine test_quadratic_spline()
    real(wp) :: x, d, s(6), g(6), s0, g0, worst
    integer :: trial, first, n, k
    worst = 0.0_wp
    do trial = 0, 200
      x = 2.0_wp + trial*0.005_wp
      call axis_weights(x, 0.5_wp, first, n, s, g)
      do k = 1, n
        d = x - (first + k - 1)
        s0 = 0.0_wp
        g0 = 0.0_wp
        if (abs(d) < 0.5_wp) then
          s0 = 0.75_wp - d*d
          g0 = -2.0_wp*d
        else if (abs(d) < 1.5_wp) then
          s0 = 0.5_wp*(1.5_wp - abs(d))**2
          g0 = -sign(1.5_wp - abs(d), d)
        end if
        worst = max(worst, abs(s(k) - s0), abs(g(k) - g0))
      end do
    end do
    call check(worst, 0.0_wp, 10*round_off, "half a cell of half length gives the quadratic B-spline")
  end subroutine test_quadratic_spline

  !> Away from nodes (further than l) the domain only averages a linear function: the tent itself, to round-off over l
  subroutine test_point_limit()
    real(wp), parameter :: l = 1.0e-3_wp
    real(wp) :: x, s(6), g(6), s0(6), g0(6), worst
    integer :: trial, first, n, first0, n0
    worst = 0.0_wp
    do trial = 1, 99
      x = 3.0_wp + 0.01_wp*trial
      call axis_weights(x, l, first, n, s, g)
      call axis_weights(x, 0.0_wp, first0, n0, s0, g0)
      if (first /= first0 .or. n /= 2 .or. n0 /= 2) worst = huge(1.0_wp)
      worst = max(worst, maxval(abs(s(:2) - s0(:2))), maxval(abs(g(:2) - g0(:2))))
    end do
    call check(worst, 0.0_wp, 10*round_off/l, "a short domain gives the tents")
    call axis_weights(0.3_wp, 1.0e-7_wp, first, n, s, g)
    call check(s(:2), [0.7_wp, 0.3_wp], 2*round_off, "below a millionth of a cell a particle is a point")
    call check(g(:2), [-1.0_wp, 1.0_wp], 0.0_wp, "and its gradients are exact")
  end subroutine test_point_limit

  !> A point exactly on a node belongs to the cell above it; a domain centred on a node has no gradient there
  subroutine test_on_a_node()
    real(wp) :: s(6), g(6)
    integer :: first, n
    call axis_weights(4.0_wp, 0.0_wp, first, n, s, g)
    call check(first, 4, "a point on node 4 is in cell 4")
    call check(s(:n), [1.0_wp, 0.0_wp], 0.0_wp, "and gives all to its node")
    call check(g(:n), [-1.0_wp, 1.0_wp], 0.0_wp, "but has the gradients of its cell")
    call axis_weights(-4.0_wp, 0.25_wp, first, n, s, g)
    call check(first, -5, "a domain around node -4 starts in cell -5")
    call check(s(:n), [0.0625_wp, 0.875_wp, 0.0625_wp], 2*round_off, "weights of a domain on a node")
    call check(g(:n), [-0.5_wp, 0.0_wp, 0.5_wp], 2*round_off, "gradients of a domain on a node")
  end subroutine test_on_a_node

  !> Any half length is the mean of tents over the domain: against sums of midpoints with the kinks at their borders
  !> (half lengths and places in multiples of 1/16, 32 midpoints in each: a sum of exact pieces)
  subroutine test_convolution()
    real(wp) :: x, l, s(6), g(6), mean, slope, y, worst
    integer :: a, b, first, n, k, m, q
    worst = 0.0_wp
    do a = 1, 32, 3
      do b = 0, 31, 5
        l = a/16.0_wp
        x = 1.0_wp + b/16.0_wp
        call axis_weights(x, l, first, n, s, g)
        do k = 1, n
          mean = 0.0_wp
          slope = 0.0_wp
          m = 2*a
          do q = 1, m
            y = x - l + (q - 0.5_wp)/16.0_wp - (first + k - 1)
            mean = mean + max(0.0_wp, 1.0_wp - abs(y))/m
            if (abs(y) < 1.0_wp) slope = slope - sign(1.0_wp, y)/m
          end do
          worst = max(worst, abs(s(k) - mean), abs(g(k) - slope))
        end do
      end do
    end do
    call check(worst, 0.0_wp, 100*round_off, "the mean of tents over the domain, for half lengths to 2")
  end subroutine test_convolution

  !> A mirrored place has mirrored weights, a shift by whole cells changes nothing but the nodes
  subroutine test_symmetry()
    real(wp) :: s(6), g(6), s0(6), g0(6)
    integer :: first, n, first0, n0
    call axis_weights(0.3125_wp, 0.875_wp, first, n, s, g)
    call axis_weights(-0.3125_wp, 0.875_wp, first0, n0, s0, g0)
    call check(n0, n, "as many nodes in the mirror")
    call check(first0, -(first + n - 1), "the mirrored nodes")
    call check(s0(n:1:-1), s(:n), 4*round_off, "mirrored weights")
    call check(-g0(n:1:-1), g(:n), 4*round_off, "mirrored gradients")
    call axis_weights(1024.3125_wp, 0.875_wp, first0, n0, s0, g0)
    call check(first0, first + 1024, "shifted nodes")
    call check(s0, s, 0.0_wp, "the same weights far out")
  end subroutine test_symmetry

end program test_basis
