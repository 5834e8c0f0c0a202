!> Tensor algebra in lanes against matmul, closed forms and the definition of an eigenvector
program test_tensor
  use gimp_kinds, only: wp, lanes
  use gimp_tensor, only: identity, increment_forward, increment_cayley, increment_exponential, multiply, determinant, &
    inverse, left_cauchy_green, push_forward, symmetric_of, rotation_cayley, rotate_symmetric, eigen_symmetric, compose, &
    natural_log, exponential, polar_rotation
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: round_off = epsilon(1.0_wp)

  call begin_suite("tensor")
  call test_products()
  call test_increments()
  call test_small_increments()
  call test_exponential()
  call test_rotation()
  call test_polar_rotation()
  call test_eigen_random()
  call test_eigen_special()
  call test_lanes_are_independent()
  call test_singular_is_finite()
  call test_log_and_exponential()
  call end_suite()

contains

  !> Reproducible numbers in (-1, 1): a linear congruential generator, the same on every machine
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

  !> One lane as a 3x3 array
  pure function full(a, k) result(matrix)
    real(wp), intent(in) :: a(lanes, 9)
    integer, intent(in) :: k
    real(wp) :: matrix(3, 3)
    matrix = transpose(reshape(a(k, :), [3, 3]))
  end function full

  pure function full_symmetric(s, k) result(matrix)
    real(wp), intent(in) :: s(lanes, 6)
    integer, intent(in) :: k
    real(wp) :: matrix(3, 3)
    matrix = reshape([s(k, 1), s(k, 4), s(k, 6), s(k, 4), s(k, 2), s(k, 5), s(k, 6), s(k, 5), s(k, 3)], [3, 3])
  end function full_symmetric

  pure function flat(matrix) result(values)
    real(wp), intent(in) :: matrix(3, 3)
    real(wp) :: values(9)
    values = reshape(transpose(matrix), [9])
  end function flat

  subroutine test_products()
    real(wp) :: a(lanes, 9), b(lanes, 9), c(lanes, 9), s(lanes, 6), t(lanes, 6), det(lanes)
    integer :: k, seed
    seed = 1
    call random_numbers(seed, a)
    call random_numbers(seed, b)
    call random_numbers(seed, s)
    call multiply(a, b, c)
    do k = 1, lanes ! tolerance: three products of numbers below one
      call check(c(k, :), flat(matmul(full(a, k), full(b, k))), 4*round_off, "product against matmul")
    end do
    call left_cauchy_green(a, t)
    do k = 1, lanes
      call check(flat(full_symmetric(t, k)), flat(matmul(full(a, k), transpose(full(a, k)))), 4*round_off, "F F^T")
    end do
    call push_forward(a, s, t)
    do k = 1, lanes
      call check(flat(full_symmetric(t, k)), flat(matmul(full(a, k), matmul(full_symmetric(s, k), transpose(full(a, k))))), &
        40*round_off, "A S A^T")
    end do
    call symmetric_of(a, t)
    do k = 1, lanes
      call check(flat(full_symmetric(t, k)), flat((full(a, k) + transpose(full(a, k)))/2), 0.0_wp, "symmetric part")
    end do
    call inverse(a, b)
    call multiply(a, b, c)
    do k = 1, lanes ! the condition number of these samples is below 100
      call check(c(k, :), identity, 1000*round_off, "inverse")
    end do
    do k = 1, lanes
      a(k, :) = [2.0_wp, 5.0_wp, -7.0_wp, 0.0_wp, real(k, wp), 3.0_wp, 0.0_wp, 0.0_wp, 4.0_wp]
    end do
    call determinant(a, det)
    call check(det, [(8.0_wp*k, k=1, lanes)], 0.0_wp, "determinant of a triangular tensor")
    a = a(:, [4, 5, 6, 1, 2, 3, 7, 8, 9])
    call determinant(a, det)
    call check(det, [(-8.0_wp*k, k=1, lanes)], 0.0_wp, "swapping two rows turns the sign")
    a = a(:, [3, 1, 2, 6, 4, 5, 9, 7, 8])
    call determinant(a, det)
    call check(det, [(-8.0_wp*k, k=1, lanes)], 0.0_wp, "cyclic columns keep the determinant")
  end subroutine test_products

  subroutine test_increments()
    real(wp) :: l(lanes, 9), df(lanes, 9), a(3, 3), eye(3, 3), det(lanes)
    integer :: k, seed
    eye = reshape(identity, [3, 3])
    seed = 2
    call random_numbers(seed, l)
    call increment_forward(0.3_wp, l, df)
    do k = 1, lanes
      call check(df(k, :), identity + 0.3_wp*l(k, :), round_off, "forward increment")
    end do
    call increment_cayley(0.3_wp, l, df)
    do k = 1, lanes
      a = 0.15_wp*full(l, k)
      call check(flat(matmul(eye - a, full(df, k))), flat(eye + a), 8*round_off, "Cayley increment solves its equation")
    end do
    l(:, [1, 5, 9]) = 0
    l(:, [4, 7, 8]) = -l(:, [2, 3, 6])
    call increment_cayley(1.0_wp, l, df)
    call determinant(df, det)
    call check(det, spread(1.0_wp, 1, lanes), 8*round_off, "a pure spin keeps the volume")
    l = 0
    l(:, 2) = 0.7_wp
    call increment_cayley(1.0_wp, l, df)
    call check(df(3, :), identity + [0.0_wp, 0.7_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], &
      0.0_wp, "simple shear is exact, other components stay untouched")
  end subroutine test_increments

  !> Plane strain must stay plane to the last bit, and a tiny increment must not be lost in the 1
  subroutine test_small_increments()
    real(wp) :: l(lanes, 9), df(lanes, 9)
    integer :: k, seed
    seed = 3
    call random_numbers(seed, l)
    l(:, [3, 6, 7, 8, 9]) = 0
    call increment_cayley(0.1_wp, l, df)
    call check(df(:, 9), spread(1.0_wp, 1, lanes), 0.0_wp, "Cayley: plane strain stays plane")
    call check_true(all(df(:, [3, 6, 7, 8]) == 0), "Cayley: no shear out of the plane")
    call increment_exponential(0.1_wp, l, df)
    call check(df(:, 9), spread(1.0_wp, 1, lanes), 0.0_wp, "exponential: plane strain stays plane")
    call check_true(all(df(:, [3, 6, 7, 8]) == 0), "exponential: no shear out of the plane")
    call increment_exponential(1.0e-9_wp, l, df)
    do k = 1, lanes ! the second order term is 1e-18
      call check(df(k, 2), 1.0e-9_wp*l(k, 2), 3.0e-18_wp + 4.0e-9_wp*round_off, "exponential of a small increment")
    end do
  end subroutine test_small_increments

  subroutine test_exponential()
    real(wp) :: l(lanes, 9), df(lanes, 9), back(lanes, 9), unit(lanes, 9), expected(9), angle
    integer :: k, seed
    do k = 1, lanes
      angle = 1.36_wp*k/lanes
      l(k, :) = [0.0_wp, -angle, 0.0_wp, angle, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.5_wp*angle]
    end do
    call increment_exponential(1.0_wp, l, df)
    do k = 1, lanes
      angle = 1.36_wp*k/lanes
      expected = [cos(angle), -sin(angle), 0.0_wp, sin(angle), cos(angle), 0.0_wp, 0.0_wp, 0.0_wp, exp(0.5_wp*angle)]
      call check(df(k, :), expected, 10*round_off, "rotation about z and stretch along z")
    end do
    l = 0
    l(:, 2) = 1
    l(:, 6) = 1
    call increment_exponential(0.9_wp, l, df)
    expected = [1.0_wp, 0.9_wp, 0.405_wp, 0.0_wp, 1.0_wp, 0.9_wp, 0.0_wp, 0.0_wp, 1.0_wp]
    call check(df(5, :), expected, 2*round_off, "a nilpotent gradient has a finite series")
    seed = 4
    call random_numbers(seed, l)
    call increment_exponential(0.4_wp, l, df)
    call increment_exponential(-0.4_wp, l, back)
    call multiply(df, back, unit)
    do k = 1, lanes
      call check(unit(k, :), identity, 20*round_off, "exp(A) exp(-A) = I")
    end do
  end subroutine test_exponential

  subroutine test_rotation()
    real(wp) :: l(lanes, 9), w(lanes, 9), q(lanes, 9), expected(lanes, 9), s(lanes, 6), turned(lanes, 6)
    integer :: k, seed
    seed = 5
    call random_numbers(seed, l)
    do k = 1, lanes
      w(k, :) = flat(full(l, k) - transpose(full(l, k)))/2
    end do
    call rotation_cayley(0.8_wp, l, q)
    call increment_cayley(0.8_wp, w, expected)
    do k = 1, lanes
      call check(q(k, :), expected(k, :), 8*round_off, "closed form against the Cayley transform of the spin")
      call check(flat(matmul(full(q, k), transpose(full(q, k)))), identity, 8*round_off, "Q Q^T = I")
    end do
    call random_numbers(seed, s)
    call push_forward(q, s, turned)
    call rotate_symmetric(q, s)
    call check_true(all(s == turned), "turning in place is the push forward")
  end subroutine test_rotation

  !> Largest errors of S n = value n, relative to |S|, and of N^T N = I
  subroutine eigen_errors(s, error, skewness)
    real(wp), intent(in) :: s(lanes, 6)
    real(wp), intent(inout) :: error, skewness
    real(wp) :: values(lanes, 3), n(lanes, 9), matrix(3, 3), columns(3, 3), residual(3, 3)
    integer :: a, k
    call eigen_symmetric(s, values, n)
    do k = 1, lanes
      matrix = full_symmetric(s, k)
      columns = full(n, k)
      do a = 1, 3
        residual(:, a) = matmul(matrix, columns(:, a)) - values(k, a)*columns(:, a)
      end do
      error = max(error, maxval(abs(residual))/max(maxval(abs(matrix)), tiny(1.0_wp)))
      residual = matmul(transpose(columns), columns) - reshape(identity, [3, 3])
      skewness = max(skewness, maxval(abs(residual)))
      if (any(n(k, :) /= n(k, :)) .or. any(values(k, :) /= values(k, :))) error = huge(1.0_wp)
    end do
  end subroutine eigen_errors

  !> Random tensors whose entries, or whose eigenvalue gaps, spread over many orders of magnitude
  subroutine test_eigen_random()
    real(wp) :: x(lanes, 9), q(lanes, 9), s(lanes, 6), values(lanes, 3), error, skewness
    integer :: sample, seed
    seed = 6
    error = 0
    skewness = 0
    do sample = 1, 3000
      call random_numbers(seed, x)
      s = x(:, 1:6)
      call eigen_errors(s, error, skewness)
      s = x(:, 1:6)*10.0_wp**(16*x(:, [7, 8, 9, 8, 9, 7]))
      call eigen_errors(s, error, skewness)
      call rotation_cayley(6.0_wp, x, q)
      call random_numbers(seed, x)
      values(:, 1) = 1
      values(:, 2) = 1 + 10.0_wp**(9*x(:, 1) - 9) ! a gap between 1 and round-off
      values(:, 3) = x(:, 2)
      call compose(values, q, s)
      call eigen_errors(s, error, skewness)
      values(:, 3) = 1 - 10.0_wp**(9*x(:, 3) - 9)
      call compose(values, q, s)
      call eigen_errors(s, error, skewness)
    end do
    call check(error, 0.0_wp, 64*round_off, "S n = value n in 96000 random tensors")
    call check(skewness, 0.0_wp, 64*round_off, "their eigenvectors are orthonormal")
  end subroutine test_eigen_random

  subroutine test_eigen_special()
    real(wp) :: s(lanes, 6), values(lanes, 3), n(lanes, 9), back(lanes, 6), error, skewness, small
    error = 0
    skewness = 0
    small = tiny(1.0_wp)**0.45_wp ! its square is still a number
    s = 0
    s(2, :) = [1.0_wp, 1.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    s(3, :) = [1.0_wp, 1.0_wp, 1.0_wp, 1.0_wp, 1.0_wp, 1.0_wp] ! 3, 0, 0
    s(4, :) = [2.0_wp, 2.0_wp, 2.0_wp, 0.05_wp*round_off, 0.05_wp*round_off, -0.05_wp*round_off]
    s(5, :) = [0.0_wp, 0.0_wp, 0.0_wp, small, 0.0_wp, small]
    s(6, :) = [1.0e12_wp, 1.0_wp, 1.0e-12_wp, 1.0_wp, 1.0e-12_wp, 1.0_wp]
    s(7, :) = [1.0_wp, 1.0_wp, -1.0_wp, 0.0_wp, 0.0_wp, 1.0_wp]
    s(8, :) = [4.0_wp, 4.0_wp, 4.0_wp, 0.0_wp, 3.0_wp, 0.0_wp]
    call eigen_errors(s, error, skewness)
    call check(error, 0.0_wp, 64*round_off, "equal, nearly equal, zero and graded tensors")
    call check(skewness, 0.0_wp, 64*round_off, "their eigenvectors are orthonormal")
    call eigen_symmetric(s, values, n)
    call check(maxval(values(3, :)), 3.0_wp, 8*round_off, "largest eigenvalue of the tensor of ones")
    call check(minval(abs(values(3, :))), 0.0_wp, 8*round_off, "its smallest eigenvalue")
    call check([maxval(values(8, :)), minval(values(8, :))], [7.0_wp, 1.0_wp], 8*round_off, "eigenvalues in one plane")
    call check(minval(values(6, :)), -1.0_wp, 8.0_wp, "graded tensor: finite small eigenvalue")
    call compose(values, n, back)
    call check(reshape(back([1, 2, 3, 4, 7, 8], :), [36]), reshape(s([1, 2, 3, 4, 7, 8], :), [36]), 20*round_off, &
      "composed again")
  end subroutine test_eigen_special

  !> The result of a lane must not depend on what its neighbours hold
  subroutine test_lanes_are_independent()
    real(wp) :: x(lanes, 9), s(lanes, 6), values(lanes, 3), n(lanes, 9), other(lanes, 3), m(lanes, 9)
    real(wp) :: df(lanes, 9), dg(lanes, 9)
    integer :: seed
    seed = 7
    call random_numbers(seed, x)
    s = x(:, 1:6)
    call eigen_symmetric(s, values, n)
    call increment_exponential(0.5_wp, x, df)
    s(2:, :) = 1000
    x(2:, :) = 3
    call eigen_symmetric(s, other, m)
    call increment_exponential(0.5_wp, x, dg)
    call check_true(all(values(1, :) == other(1, :)) .and. all(n(1, :) == m(1, :)), "eigenvalues bit for bit")
    call check_true(all(df(1, :) == dg(1, :)), "exponential bit for bit")
  end subroutine test_lanes_are_independent

  !> F = R U: R is the rotation put in, for ordinary stretches and for ratios of 10^4, alone or in company; finite numbers for F without one
  subroutine test_polar_rotation()
    real(wp) :: x(lanes, 9), q(lanes, 9), n(lanes, 9), values(lanes, 3), u(lanes, 6), f(lanes, 9), r(lanes, 9), alone(lanes, 9)
    real(wp) :: worst(2), most
    integer :: k, sample, seed, size
    seed = 11
    worst = 0
    do size = 1, 2
      most = merge(0.7_wp, 2.0_wp, size == 1)
      if (size == 2 .and. round_off > 1.0e-10_wp) most = 1.0_wp
      do sample = 1, 200
        call random_numbers(seed, x)
        call rotation_cayley(4.0_wp, x, q)
        values = 10.0_wp**(most*x(:, [1, 5, 9]))
        call random_numbers(seed, x)
        call rotation_cayley(4.0_wp, x, n)
        call compose(values, n, u)
        call multiply(q, u(:, [1, 4, 6, 4, 2, 5, 6, 5, 3]), f)
        call polar_rotation(f, r)
        worst(size) = max(worst(size), maxval(abs(r - q)/spread(maxval(values, 2)/minval(values, 2), 2, 9)))
      end do
    end do
    ! R is as well determined as the shortest stretch is: round-off times the ratio of the stretches
    call check(worst, [0.0_wp, 0.0_wp], 8*round_off, "the rotation of F = R U")
    f(2:, :) = spread(identity, 1, lanes - 1)
    call polar_rotation(f, alone)
    call check_true(all(alone(1, :) == r(1, :)), "a lane does not depend on its neighbours")
    f = 0
    do k = 1, lanes
      f(k, [1, 5, 9]) = [real(k - 4, wp), 1.0_wp, 1.0_wp] ! inverted, flat, sound
    end do
    f(1, :) = 0
    call polar_rotation(f, r)
    call check_true(all(abs(r(:4, :)) <= 1.0e20_wp), "inverted and flat: finite")
    call check(r(5, :), identity, round_off, "and no harm to a neighbour")
  end subroutine test_polar_rotation

  subroutine test_singular_is_finite()
    real(wp) :: a(lanes, 9), b(lanes, 9), l(lanes, 9)
    a = 0
    call inverse(a, b)
    call check_true(all(abs(b) <= huge(1.0_wp)), "inverse of zero holds no NaN")
    l = 0
    l(:, [1, 5, 9]) = 2 ! I - dt L/2 = 0
    call increment_cayley(1.0_wp, l, b)
    call check_true(all(abs(b) <= huge(1.0_wp)), "Cayley increment of a singular step holds no NaN")
  end subroutine test_singular_is_finite

  subroutine test_log_and_exponential()
    real(wp) :: x(lanes), y(lanes), far
    integer :: k
    x = 1.0_wp
    x(:8) = [1.0_wp, 1 + round_off, 0.5_wp, 7.0_wp, 10*tiny(1.0_wp), 0.1_wp*huge(1.0_wp), 0.0_wp, -3.0_wp]
    y = x
    call natural_log(y)
    do k = 1, 6 ! the vector library promises 4 units in the last place
      call check(y(k), log(x(k)), 4*round_off*abs(log(x(k))), "logarithm")
    end do
    call check(y(7:8), spread(log(tiny(1.0_wp)), 1, 2), 4*round_off*710, "logarithm of what is not positive is cut")
    far = 0.85_wp*log(huge(1.0_wp))
    x = 0.0_wp
    x(:8) = [0.0_wp, round_off, -1.0_wp, 1.0_wp, far, -far, 1.0e5_wp, -1.0e5_wp]
    y = x
    call exponential(y)
    do k = 1, 6
      call check(y(k), exp(x(k)), 4*round_off*exp(x(k)), "exponential")
    end do
    call check_true(y(7) > huge(1.0_wp)**0.9755_wp .and. y(8) < tiny(1.0_wp)**0.9755_wp .and. all(y <= huge(1.0_wp)), &
      "exponential never overflows")
  end subroutine test_log_and_exponential

end program test_tensor
