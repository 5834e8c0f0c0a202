!> Logarithmic strain and its inverse against closed forms, over all sizes of strain
program test_tensor_functions
  use gimp_kinds, only: wp, lanes
  use gimp_tensor, only: identity, rotation_cayley, compose, left_cauchy_green, push_forward, multiply
  use gimp_tensor_functions, only: half_logarithm, strain_logarithm, exponential_of_twice, strain_of, push_forward_strain, &
    squared_norm
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: round_off = epsilon(1.0_wp)

  call begin_suite("tensor functions")
  call test_increment_products()
  call test_known_axes()
  call test_there_and_back()
  call test_both_sides_of_the_limit()
  call test_nearly_equal_stretches()
  call test_lanes_are_independent()
  call test_extremes_are_finite()
  call end_suite()

contains

  !> Reproducible numbers in (-1, 1)
  subroutine random_numbers(seed, x)
    integer, intent(inout) :: seed
    real(wp), intent(out) :: x(:, :)
    integer :: i, j
    do j = 1, size(x, 2)
      do i = 1, size(x, 1)
        seed = modulo(16807*modulo(seed, 127773) - 2836*(seed/127773), 2147483647)
        x(i, j) = 2*(seed/2147483647.0_wp) - 1
      end do
    end do
  end subroutine random_numbers

  !> Principal values and a rotation; the tensor with those values in turned axes
  subroutine turned(seed, values, s)
    integer, intent(inout) :: seed
    real(wp), intent(in) :: values(lanes, 3)
    real(wp), intent(out) :: s(lanes, 6)
    real(wp) :: x(lanes, 9), q(lanes, 9)
    call random_numbers(seed, x)
    call rotation_cayley(6.0_wp, x, q)
    call compose(values, q, s)
  end subroutine turned

  !> F F^T - I and A (I + X) A^T - I are the plain products, with the digits of small numbers
  subroutine test_increment_products()
    real(wp) :: f(lanes, 9), a(lanes, 9), x(lanes, 6), y(lanes, 6), b(lanes, 6), unit(6)
    integer :: k, seed
    seed = 3
    unit = [1, 1, 1, 0, 0, 0]
    call random_numbers(seed, f)
    call random_numbers(seed, a)
    call left_cauchy_green(f, b)
    call strain_of(f, x)
    do k = 1, lanes ! sums of nine products of numbers below two
      call check(x(k, :) + unit, b(k, :), 16*round_off, "F F^T")
    end do
    call push_forward(a, b, y)
    call push_forward_strain(a, x, b)
    do k = 1, lanes
      call check(b(k, :) + unit, y(k, :), 100*round_off, "A (I + X) A^T")
    end do
    f = 2.0_wp**(-40)*f + spread(identity, 1, lanes)
    call strain_of(f, x)
    do k = 1, lanes ! the linear part; what is left of it is its square, 2**-40 of it
      f(k, :) = f(k, :) - identity
      call check(x(k, :)*2.0_wp**40, 2.0_wp**40*[2*f(k, 1), 2*f(k, 5), 2*f(k, 9), f(k, 2) + f(k, 4), f(k, 6) + f(k, 8), &
        f(k, 3) + f(k, 7)], 2.0_wp**(-37), "small increments keep their digits")
    end do
  end subroutine test_increment_products

  !> Diagonal tensors, from strains of round-off to stretches of 100 and 1/100
  subroutine test_known_axes()
    real(wp) :: e(lanes, 6), x(lanes, 6), back(lanes, 6), f(lanes, 9), r
    integer :: k, p
    do p = -16, 0
      do k = 1, lanes
        r = 4.6_wp*10.0_wp**p
        e(k, :) = [r*cos(1.0_wp*k), r*sin(2.0_wp*k), r*cos(3.0_wp*k + 1), 0.0_wp, 0.0_wp, 0.0_wp]
      end do
      call exponential_of_twice(e, x)
      do k = 1, lanes ! squaring n times loses up to n digits of the exponent: |2 e| round-offs of the largest value
        back(k, 1:3) = 2*e(k, 1:3)*(1 + e(k, 1:3) + 2*e(k, 1:3)**2/3 + e(k, 1:3)**3/3) ! for small strains, where exp - 1 has no digits
        if (p > -5) back(k, 1:3) = exp(2*e(k, 1:3)) - 1
        call check(x(k, 1:3)/maxval(abs(back(k, 1:3))), back(k, 1:3)/maxval(abs(back(k, 1:3))), &
          merge(max(60*round_off, round_off/r), 4*round_off, p > -5), "exponential of a diagonal")
      end do
      f = 0
      f(:, 1:9:4) = exp(e(:, 1:3))
      call strain_logarithm(f, back)
      do k = 1, lanes ! the stretches are rounded to 1 +- round-off
        call check(back(k, :), e(k, :), 2*round_off*(1 + r), "logarithm of diagonal stretches")
      end do
    end do
  end subroutine test_known_axes

  !> e -> x -> e in turned axes
  subroutine test_there_and_back()
    real(wp) :: e(lanes, 6), x(lanes, 6), back(lanes, 6), values(lanes, 3), norm(lanes), worst(3)
    integer :: k, n, seed
    seed = 5
    worst = 0
    do n = 1, 2000
      call random_numbers(seed, values)
      values = values*10.0_wp**(-modulo(n, 17))
      call turned(seed, values, e)
      call exponential_of_twice(e, x)
      call half_logarithm(x, back)
      call squared_norm(e, norm)
      norm = sqrt(norm)
      do k = 1, lanes
        if (norm(k) < 0.07_wp) then
          worst(1) = max(worst(1), maxval(abs(back(k, :) - e(k, :)))/norm(k))
        else ! the smallest value of b = exp(2 e) inherits the round-off of the largest
          worst(2) = max(worst(2), maxval(abs(back(k, :) - e(k, :)))/exp(4*norm(k)))
        end if
      end do
    end do
    call check(worst(1), 0.0_wp, 6*round_off, "small strains come back to round-off of the strain")
    call check(worst(2), 0.0_wp, 6*round_off, "large strains come back to round-off of exp(2 e)")
  end subroutine test_there_and_back

  !> The ways to a logarithm or an exponential agree where they meet, so that the stress has no jump there
  subroutine test_both_sides_of_the_limit()
    real(wp) :: e(lanes, 6), x(lanes, 6), y(lanes, 6), values(lanes, 3), norm(lanes), below(lanes, 6), above(lanes, 6)
    integer :: n, seed
    seed = 9
    do n = 1, 50
      call random_numbers(seed, values)
      norm = sqrt(sum(values**2, 2))
      values = values*spread(0.4_wp/norm, 2, 3) ! of Z; X = 2 Z/(1 - Z)
      values = 2*values/(1 - values)
      call turned(seed, values, x)
      y = x*(1 - 16*round_off)
      call half_logarithm(y, below)
      y = x*(1 + 16*round_off)
      call half_logarithm(y, above)
      call check_true(maxval(abs(above - below)) < 60*round_off, "logarithm: no jump at the limit of the second series")
      call squared_norm(x, norm)
      x = x*spread(0.15_wp/sqrt(norm), 2, 6)
      y = x*(1 - 8*round_off)
      call half_logarithm(y, below)
      y = x*(1 + 8*round_off)
      call half_logarithm(y, above)
      call check_true(maxval(abs(above - below)) < 12*round_off, "logarithm: no jump at the limit of the series")
      e = 0.5_wp*x
      y = e*(1 - 8*round_off)
      call exponential_of_twice(y, below)
      y = e*(1 + 8*round_off)
      call exponential_of_twice(y, above)
      call check_true(maxval(abs(above - below)) < 8*round_off, "exponential: no jump at the limit of the series")
    end do
  end subroutine test_both_sides_of_the_limit

  !> Equal and nearly equal stretches of every gap: e = ln(u) in turned axes
  subroutine test_nearly_equal_stretches()
    real(wp) :: x(lanes, 6), e(lanes, 6), expected(lanes, 6), values(lanes, 3), worst
    real(wp), parameter :: mean(4) = [0.01_wp, 1.0_wp, 1.3_wp, 100.0_wp] ! squares of stretches
    integer :: gap, m, n, seed
    seed = 12
    do m = 1, 4
      worst = 0
      do gap = -17, -1
        do n = 1, 8
          call random_numbers(seed, values)
          values = mean(m)*(1 + merge(0.0_wp, 1.0_wp, gap == -17)*10.0_wp**gap*values)
          call turned_again(n, values, x)
          x(:, :3) = x(:, :3) - 1
          call half_logarithm(x, e)
          call turned_again(n, 0.5_wp*log(values), expected)
          worst = max(worst, maxval(abs(e - expected)))
        end do
      end do
      call check(worst, 0.0_wp, 10*round_off*max(1.0_wp, 1/mean(m), abs(log(mean(m)))), &
        "logarithm of nearly equal squares of stretches") ! x is known to round-off of 1
    end do
  end subroutine test_nearly_equal_stretches

  !> The same axes whenever the seed is the same
  subroutine turned_again(seed, values, s)
    integer, intent(in) :: seed
    real(wp), intent(in) :: values(lanes, 3)
    real(wp), intent(out) :: s(lanes, 6)
    integer :: same
    same = seed
    call turned(same, values, s)
  end subroutine turned_again

  !> The result of a lane must not depend on what its neighbours hold
  subroutine test_lanes_are_independent()
    real(wp) :: x(lanes, 6), alone(lanes, 6), beside(lanes, 6)
    integer :: seed
    seed = 4
    call random_numbers(seed, x)
    x = 0.01_wp*x
    call half_logarithm(x, alone)
    x(2:3, :) = 0.1_wp
    call half_logarithm(x, beside)
    call check_true(all(alone(1, :) == beside(1, :)), "logarithm bit for bit")
    x(2:, :) = 0.9_wp
    call half_logarithm(x, beside)
    call check_true(all(alone(1, :) == beside(1, :)), "logarithm bit for bit beside large strains")
    x(1, :) = 0.01_wp
    x(2:, :) = 0.01_wp
    call exponential_of_twice(x, alone)
    x(2:, :) = 3
    call exponential_of_twice(x, beside)
    call check_true(all(alone(1, :) == beside(1, :)), "exponential bit for bit")
    x(1, :) = 1
    call exponential_of_twice(x, alone)
    x(2:, :) = 0
    call exponential_of_twice(x, beside)
    call check_true(all(alone(1, :) == beside(1, :)), "exponential of a large strain bit for bit")
  end subroutine test_lanes_are_independent

  !> What a run that fails may ask for must not trap
  subroutine test_extremes_are_finite()
    real(wp) :: x(lanes, 6), e(lanes, 6)
    x = -1
    call half_logarithm(x, e)
    call check_true(all(abs(e) <= huge(1.0_wp)), "logarithm of what is not positive is finite")
    x = 1.0e4_wp
    call exponential_of_twice(x, e)
    call check_true(all(abs(e) <= huge(1.0_wp)), "exponential never overflows")
    x = 0
    call exponential_of_twice(x, e)
    call check_true(all(e == 0), "exponential of zero is the unit tensor")
    call half_logarithm(x, e)
    call check_true(all(e == 0), "logarithm of the unit tensor is zero")
  end subroutine test_extremes_are_finite

end program test_tensor_functions
