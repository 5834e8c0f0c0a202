!> 3x3 tensor algebra on the lanes of a chunk: increments of the deformation gradient, products, determinants.
!>
!> Full tensors have nine components row by row (3*(i-1)+j is A_ij), symmetric ones six (xx, yy, zz, xy, yz, zx). Nothing
!> here traps for a singular tensor: a division by zero is replaced by one by a tiny number, and the caller checks J itself.
!> The body of each lane loop is plain scalar code, because that is what the compiler turns into vector instructions.
module gimp_tensor
  use gimp_kinds, only: wp, lanes
  implicit none(type, external)
  private
  public :: identity, increment, increment_forward, increment_cayley, increment_exponential, multiply, determinant, inverse
  public :: left_cauchy_green, push_forward, symmetric_of, rotation_cayley, rotate_symmetric, natural_log, exponential
  public :: eigen_symmetric, compose, polar_rotation

  !> The unit tensor, row by row
  real(wp), parameter :: identity(9) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp]

contains

  !> The increment by the rule of the scene: 2 forward, 3 exponential, else Cayley
  pure subroutine increment(rule, dt, l, df)
    integer, intent(in) :: rule
    real(wp), intent(in) :: dt !! step [s]
    real(wp), intent(in) :: l(lanes, 9) !! velocity gradient [1/s]
    real(wp), intent(out) :: df(lanes, 9) !! increment of the deformation gradient
    select case (rule)
    case (2); call increment_forward(dt, l, df)
    case (3); call increment_exponential(dt, l, df)
    case default; call increment_cayley(dt, l, df)
    end select
  end subroutine increment

  !> dF = I + dt L: first order; a pure spin theta per step makes the volume grow by 1 + theta^2
  pure subroutine increment_forward(dt, l, df)
    real(wp), intent(in) :: dt !! step [s]
    real(wp), intent(in) :: l(lanes, 9) !! velocity gradient [1/s]
    real(wp), intent(out) :: df(lanes, 9) !! increment of the deformation gradient
    integer :: c, k
    do c = 1, 9
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        df(k, c) = identity(c) + dt*l(k, c)
      end do
    end do
  end subroutine increment_forward

  !> dF = (I - dt L/2)^-1 (I + dt L/2): second order, the determinant of a pure spin is exactly 1
  !>
  !> Written as I + (I - A/2)^-1 A with A = dt L, which keeps the digits of small increments.
  pure subroutine increment_cayley(dt, l, df)
    real(wp), intent(in) :: dt !! step [s]
    real(wp), intent(in) :: l(lanes, 9) !! velocity gradient [1/s], understood at mid step
    real(wp), intent(out) :: df(lanes, 9) !! increment of the deformation gradient
    integer :: k
    real(wp) :: h
    h = 0.5_wp*dt
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: b11, b12, b13, b21, b22, b23, b31, b32, b33 ! B = I - A/2
        real(wp) :: c11, c12, c13, c21, c22, c23, c31, c32, c33 ! its adjugate
        real(wp) :: det, s
        b11 = 1.0_wp - h*l(k, 1)
        b12 = -h*l(k, 2)
        b13 = -h*l(k, 3)
        b21 = -h*l(k, 4)
        b22 = 1.0_wp - h*l(k, 5)
        b23 = -h*l(k, 6)
        b31 = -h*l(k, 7)
        b32 = -h*l(k, 8)
        b33 = 1.0_wp - h*l(k, 9)
        c11 = b22*b33 - b23*b32
        c12 = b13*b32 - b12*b33
        c13 = b12*b23 - b13*b22
        c21 = b23*b31 - b21*b33
        c22 = b11*b33 - b13*b31
        c23 = b13*b21 - b11*b23
        c31 = b21*b32 - b22*b31
        c32 = b12*b31 - b11*b32
        c33 = b11*b22 - b12*b21
        det = b11*c11 + b12*c21 + b13*c31
        s = dt/merge(det, tiny(1.0_wp), abs(det) > tiny(1.0_wp))
        df(k, 1) = 1.0_wp + s*(c11*l(k, 1) + c12*l(k, 4) + c13*l(k, 7))
        df(k, 2) = s*(c11*l(k, 2) + c12*l(k, 5) + c13*l(k, 8))
        df(k, 3) = s*(c11*l(k, 3) + c12*l(k, 6) + c13*l(k, 9))
        df(k, 4) = s*(c21*l(k, 1) + c22*l(k, 4) + c23*l(k, 7))
        df(k, 5) = 1.0_wp + s*(c21*l(k, 2) + c22*l(k, 5) + c23*l(k, 8))
        df(k, 6) = s*(c21*l(k, 3) + c22*l(k, 6) + c23*l(k, 9))
        df(k, 7) = s*(c31*l(k, 1) + c32*l(k, 4) + c33*l(k, 7))
        df(k, 8) = s*(c31*l(k, 2) + c32*l(k, 5) + c33*l(k, 8))
        df(k, 9) = 1.0_wp + s*(c31*l(k, 3) + c32*l(k, 6) + c33*l(k, 9))
      end block
    end do
  end subroutine increment_cayley

  !> dF = exp(dt L): exact for a constant velocity gradient
  !>
  !> Taylor series of degree 10 of dt L/8, then squared three times: truncation below round-off for |dt L| < 1.5, far above
  !> any step the time step control lets pass. The same work for every lane, so a result never depends on its neighbours.
  !> Squaring acts on E = exp - I (E <- 2E + E^2), which keeps the digits of small increments.
  pure subroutine increment_exponential(dt, l, df)
    real(wp), intent(in) :: dt !! step [s]
    real(wp), intent(in) :: l(lanes, 9) !! velocity gradient [1/s]
    real(wp), intent(out) :: df(lanes, 9) !! increment of the deformation gradient
    integer, parameter :: degree = 10, squarings = 3
    real(wp) :: a(lanes, 9), e(lanes, 9), product(lanes, 9)
    integer :: c, k, n
    do c = 1, 9
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        a(k, c) = dt*0.5_wp**squarings*l(k, c)
        e(k, c) = a(k, c)/real(degree, wp)
      end do
    end do
    do n = degree - 1, 1, -1 ! Horner: E <- (A + A E)/n
      call multiply(a, e, product)
      do c = 1, 9
        !$omp simd simdlen(lanes)
        do k = 1, lanes
          e(k, c) = (a(k, c) + product(k, c))/real(n, wp)
        end do
      end do
    end do
    do n = 1, squarings
      call multiply(e, e, product)
      do c = 1, 9
        !$omp simd simdlen(lanes)
        do k = 1, lanes
          e(k, c) = 2*e(k, c) + product(k, c)
        end do
      end do
    end do
    do c = 1, 9
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        df(k, c) = identity(c) + e(k, c)
      end do
    end do
  end subroutine increment_exponential

  !> C = A B, for example F_new = dF F
  pure subroutine multiply(a, b, c)
    real(wp), intent(in) :: a(lanes, 9), b(lanes, 9)
    real(wp), intent(out) :: c(lanes, 9) !! must be another array than a and b
    integer :: i, j, k
    do i = 0, 6, 3
      do j = 1, 3
        !$omp simd simdlen(lanes)
        do k = 1, lanes
          c(k, i + j) = a(k, i + 1)*b(k, j) + a(k, i + 2)*b(k, j + 3) + a(k, i + 3)*b(k, j + 6)
        end do
      end do
    end do
  end subroutine multiply

  !> The determinant
  pure subroutine determinant(a, det)
    real(wp), intent(in) :: a(lanes, 9)
    real(wp), intent(out) :: det(lanes)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      det(k) = a(k, 1)*(a(k, 5)*a(k, 9) - a(k, 6)*a(k, 8)) + a(k, 2)*(a(k, 6)*a(k, 7) - a(k, 4)*a(k, 9)) &
        + a(k, 3)*(a(k, 4)*a(k, 8) - a(k, 5)*a(k, 7))
    end do
  end subroutine determinant

  !> The inverse; huge numbers where the tensor is singular
  pure subroutine inverse(a, b)
    real(wp), intent(in) :: a(lanes, 9)
    real(wp), intent(out) :: b(lanes, 9) !! must be another array than a
    real(wp) :: det(lanes), s
    integer :: k
    call determinant(a, det)
    !$omp simd simdlen(lanes) private(s)
    do k = 1, lanes
      s = 1.0_wp/merge(det(k), tiny(1.0_wp), abs(det(k)) > tiny(1.0_wp))
      b(k, 1) = s*(a(k, 5)*a(k, 9) - a(k, 6)*a(k, 8))
      b(k, 2) = s*(a(k, 3)*a(k, 8) - a(k, 2)*a(k, 9))
      b(k, 3) = s*(a(k, 2)*a(k, 6) - a(k, 3)*a(k, 5))
      b(k, 4) = s*(a(k, 6)*a(k, 7) - a(k, 4)*a(k, 9))
      b(k, 5) = s*(a(k, 1)*a(k, 9) - a(k, 3)*a(k, 7))
      b(k, 6) = s*(a(k, 3)*a(k, 4) - a(k, 1)*a(k, 6))
      b(k, 7) = s*(a(k, 4)*a(k, 8) - a(k, 5)*a(k, 7))
      b(k, 8) = s*(a(k, 2)*a(k, 7) - a(k, 1)*a(k, 8))
      b(k, 9) = s*(a(k, 1)*a(k, 5) - a(k, 2)*a(k, 4))
    end do
  end subroutine inverse

  !> b = F F^T
  pure subroutine left_cauchy_green(f, b)
    real(wp), intent(in) :: f(lanes, 9) !! deformation gradient
    real(wp), intent(out) :: b(lanes, 6) !! left Cauchy-Green tensor
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      b(k, 1) = f(k, 1)*f(k, 1) + f(k, 2)*f(k, 2) + f(k, 3)*f(k, 3)
      b(k, 2) = f(k, 4)*f(k, 4) + f(k, 5)*f(k, 5) + f(k, 6)*f(k, 6)
      b(k, 3) = f(k, 7)*f(k, 7) + f(k, 8)*f(k, 8) + f(k, 9)*f(k, 9)
      b(k, 4) = f(k, 1)*f(k, 4) + f(k, 2)*f(k, 5) + f(k, 3)*f(k, 6)
      b(k, 5) = f(k, 4)*f(k, 7) + f(k, 5)*f(k, 8) + f(k, 6)*f(k, 9)
      b(k, 6) = f(k, 7)*f(k, 1) + f(k, 8)*f(k, 2) + f(k, 9)*f(k, 3)
    end do
  end subroutine left_cauchy_green

  !> B = A S A^T for a symmetric S: an increment applied to b, or a rotation applied to a stress
  pure subroutine push_forward(a, s, b)
    real(wp), intent(in) :: a(lanes, 9)
    real(wp), intent(in) :: s(lanes, 6)
    real(wp), intent(out) :: b(lanes, 6) !! must be another array than s
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: t11, t12, t13, t21, t22, t23, t31, t32, t33 ! T = A S
        t11 = a(k, 1)*s(k, 1) + a(k, 2)*s(k, 4) + a(k, 3)*s(k, 6)
        t12 = a(k, 1)*s(k, 4) + a(k, 2)*s(k, 2) + a(k, 3)*s(k, 5)
        t13 = a(k, 1)*s(k, 6) + a(k, 2)*s(k, 5) + a(k, 3)*s(k, 3)
        t21 = a(k, 4)*s(k, 1) + a(k, 5)*s(k, 4) + a(k, 6)*s(k, 6)
        t22 = a(k, 4)*s(k, 4) + a(k, 5)*s(k, 2) + a(k, 6)*s(k, 5)
        t23 = a(k, 4)*s(k, 6) + a(k, 5)*s(k, 5) + a(k, 6)*s(k, 3)
        t31 = a(k, 7)*s(k, 1) + a(k, 8)*s(k, 4) + a(k, 9)*s(k, 6)
        t32 = a(k, 7)*s(k, 4) + a(k, 8)*s(k, 2) + a(k, 9)*s(k, 5)
        t33 = a(k, 7)*s(k, 6) + a(k, 8)*s(k, 5) + a(k, 9)*s(k, 3)
        b(k, 1) = t11*a(k, 1) + t12*a(k, 2) + t13*a(k, 3)
        b(k, 2) = t21*a(k, 4) + t22*a(k, 5) + t23*a(k, 6)
        b(k, 3) = t31*a(k, 7) + t32*a(k, 8) + t33*a(k, 9)
        b(k, 4) = t11*a(k, 4) + t12*a(k, 5) + t13*a(k, 6)
        b(k, 5) = t21*a(k, 7) + t22*a(k, 8) + t23*a(k, 9)
        b(k, 6) = t31*a(k, 1) + t32*a(k, 2) + t33*a(k, 3)
      end block
    end do
  end subroutine push_forward

  !> sym A = (A + A^T)/2
  pure subroutine symmetric_of(a, s)
    real(wp), intent(in) :: a(lanes, 9)
    real(wp), intent(out) :: s(lanes, 6)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      s(k, 1) = a(k, 1)
      s(k, 2) = a(k, 5)
      s(k, 3) = a(k, 9)
      s(k, 4) = 0.5_wp*(a(k, 2) + a(k, 4))
      s(k, 5) = 0.5_wp*(a(k, 6) + a(k, 8))
      s(k, 6) = 0.5_wp*(a(k, 7) + a(k, 3))
    end do
  end subroutine symmetric_of

  !> Q = (I - dt W/2)^-1 (I + dt W/2) with W = skw L (Hughes & Winget 1980): a rotation to round-off
  !>
  !> In closed form, with X the skew tensor dt W/2 of axial vector x: Q = I + 2/(1 + x.x) (X + X X).
  pure subroutine rotation_cayley(dt, l, q)
    real(wp), intent(in) :: dt !! step [s]
    real(wp), intent(in) :: l(lanes, 9) !! velocity gradient [1/s]
    real(wp), intent(out) :: q(lanes, 9)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: x, y, z, s
        x = 0.25_wp*dt*(l(k, 8) - l(k, 6))
        y = 0.25_wp*dt*(l(k, 3) - l(k, 7))
        z = 0.25_wp*dt*(l(k, 4) - l(k, 2))
        s = 2.0_wp/(1.0_wp + x*x + y*y + z*z)
        q(k, 1) = 1.0_wp - s*(y*y + z*z)
        q(k, 2) = s*(x*y - z)
        q(k, 3) = s*(x*z + y)
        q(k, 4) = s*(x*y + z)
        q(k, 5) = 1.0_wp - s*(x*x + z*z)
        q(k, 6) = s*(y*z - x)
        q(k, 7) = s*(x*z - y)
        q(k, 8) = s*(y*z + x)
        q(k, 9) = 1.0_wp - s*(x*x + y*y)
      end block
    end do
  end subroutine rotation_cayley

  !> Q S Q^T, in place
  pure subroutine rotate_symmetric(q, s)
    real(wp), intent(in) :: q(lanes, 9)
    real(wp), intent(inout) :: s(lanes, 6)
    real(wp) :: turned(lanes, 6)
    integer :: c, k
    call push_forward(q, s, turned)
    do c = 1, 6
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        s(k, c) = turned(k, c)
      end do
    end do
  end subroutine rotate_symmetric

  !> Eigenvalues and eigenvectors of symmetric tensors, S = N diag(values) N^T; in no particular order
  !>
  !> Cyclic Jacobi (Golub & Van Loan 2013, 8.5): equal and nearly equal eigenvalues need no special case, which a closed form
  !> with trigonometric functions does not offer. Sweeps end when every off-diagonal number of the chunk is exactly zero: a
  !> lane that has arrived is only turned by the unit rotation, so no lane depends on its neighbours, and a plane tensor needs
  !> one sweep. In 4 10^6 random tensors of every grading four sweeps were always enough (residual 1.4e-15; three: 3e-5).
  !> Entries below the square root of the smallest number are too small for the squares in the rotation.
  pure subroutine eigen_symmetric(s, values, n)
    real(wp), intent(in) :: s(lanes, 6)
    real(wp), intent(out) :: values(lanes, 3)
    real(wp), intent(out) :: n(lanes, 9) !! column A, that is components A, A+3, A+6, is the unit eigenvector of value A
    integer, parameter :: sweeps = 5 !! at most
    real(wp) :: off(lanes, 3)
    integer :: c, k, sweep
    do c = 1, 3
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        values(k, c) = s(k, c)
        off(k, c) = s(k, c + 3)
      end do
    end do
    do c = 1, 9
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        n(k, c) = identity(c)
      end do
    end do
    do sweep = 1, sweeps
      call annihilate(values(:, 1), values(:, 2), values(:, 3), off(:, 1), off(:, 3), off(:, 2), &
        n(:, 1), n(:, 2), n(:, 4), n(:, 5), n(:, 7), n(:, 8))
      call annihilate(values(:, 1), values(:, 3), values(:, 2), off(:, 3), off(:, 1), off(:, 2), &
        n(:, 1), n(:, 3), n(:, 4), n(:, 6), n(:, 7), n(:, 9))
      call annihilate(values(:, 2), values(:, 3), values(:, 1), off(:, 2), off(:, 1), off(:, 3), &
        n(:, 2), n(:, 3), n(:, 5), n(:, 6), n(:, 8), n(:, 9))
      if (.not. any_nonzero(off(:, 1), off(:, 2), off(:, 3))) exit
    end do
  end subroutine eigen_symmetric

  !> One Jacobi rotation in the plane p, q (r is the third index), which makes a_pq zero
  !>
  !> Off-diagonal numbers that can no longer change a digit of the diagonal become zero. The tangent
  !> t = 2 a_pq/(d +- sqrt(d^2 + 4 a_pq^2)), d = a_qq - a_pp, is written so that |t| <= 1 and nothing is divided by zero,
  !> whatever underflows.
  pure subroutine annihilate(app, aqq, arr, apq, arp, arq, n1p, n1q, n2p, n2q, n3p, n3q)
    real(wp), intent(inout), dimension(lanes) :: app, aqq, apq, arp, arq, n1p, n1q, n2p, n2q, n3p, n3q
    real(wp), intent(in) :: arr(lanes)
    real(wp), parameter :: negligible = 0.01_wp*epsilon(1.0_wp), least = 2.0_wp*sqrt(tiny(1.0_wp))
    integer :: k
    if (.not. any_nonzero(apq, apq, apq)) return ! two planes of three in plane strain
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: d, a, u, r, t, c, s, x, y, small
        d = aqq(k) - app(k)
        a = sign(2.0_wp, d)*apq(k)
        u = max(abs(d) + sqrt(d*d + a*a), abs(a), least)
        t = a/u
        r = 1.0_wp/sqrt(u*u + a*a) ! beside t, not after it: what this loop waits for is the chain of roots and quotients
        c = u*r
        s = a*r
        app(k) = app(k) - t*apq(k)
        aqq(k) = aqq(k) + t*apq(k)
        small = merge(negligible, -1.0_wp, abs(a) > 0.0_wp) ! without a rotation nothing at all changes
        apq(k) = 0.0_wp
        x = arp(k)
        y = s*x + c*arq(k)
        x = c*x - s*arq(k)
        arp(k) = merge(x, 0.0_wp, abs(x) > small*min(abs(arr(k)), abs(app(k))))
        arq(k) = merge(y, 0.0_wp, abs(y) > small*min(abs(arr(k)), abs(aqq(k))))
        x = n1p(k)
        n1p(k) = c*x - s*n1q(k)
        n1q(k) = s*x + c*n1q(k)
        x = n2p(k)
        n2p(k) = c*x - s*n2q(k)
        n2q(k) = s*x + c*n2q(k)
        x = n3p(k)
        n3p(k) = c*x - s*n3q(k)
        n3q(k) = s*x + c*n3q(k)
      end block
    end do
  end subroutine annihilate

  !> Whether any of three numbers differs from zero in any lane
  pure logical function any_nonzero(a, b, c)
    real(wp), intent(in), dimension(lanes) :: a, b, c
    real(wp) :: largest
    integer :: k
    largest = 0.0_wp
    !$omp simd simdlen(lanes) reduction(max:largest)
    do k = 1, lanes
      largest = max(largest, abs(a(k)), abs(b(k)), abs(c(k)))
    end do
    any_nonzero = largest > 0.0_wp
  end function any_nonzero

  !> S = N diag(values) N^T
  pure subroutine compose(values, n, s)
    real(wp), intent(in) :: values(lanes, 3)
    real(wp), intent(in) :: n(lanes, 9) !! eigenvectors as columns, as `eigen_symmetric` gives them
    real(wp), intent(out) :: s(lanes, 6)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      s(k, 1) = values(k, 1)*n(k, 1)*n(k, 1) + values(k, 2)*n(k, 2)*n(k, 2) + values(k, 3)*n(k, 3)*n(k, 3)
      s(k, 2) = values(k, 1)*n(k, 4)*n(k, 4) + values(k, 2)*n(k, 5)*n(k, 5) + values(k, 3)*n(k, 6)*n(k, 6)
      s(k, 3) = values(k, 1)*n(k, 7)*n(k, 7) + values(k, 2)*n(k, 8)*n(k, 8) + values(k, 3)*n(k, 9)*n(k, 9)
      s(k, 4) = values(k, 1)*n(k, 1)*n(k, 4) + values(k, 2)*n(k, 2)*n(k, 5) + values(k, 3)*n(k, 3)*n(k, 6)
      s(k, 5) = values(k, 1)*n(k, 4)*n(k, 7) + values(k, 2)*n(k, 5)*n(k, 8) + values(k, 3)*n(k, 6)*n(k, 9)
      s(k, 6) = values(k, 1)*n(k, 7)*n(k, 1) + values(k, 2)*n(k, 8)*n(k, 2) + values(k, 3)*n(k, 9)*n(k, 3)
    end do
  end subroutine compose

  !> The rotation R of F = R U, by Newton's iteration R <- (R + R^-T)/2 from F scaled to unit size (Higham 1986)
  !>
  !> Usual strains take three or four steps; twenty reach round-off for principal stretch ratios up to some 10^4. A lane whose
  !> last step was below `settled` stands still, since the next one would be its square: so a lane never depends on how long its
  !> neighbours take. Inverted and flat F give finite numbers that are no rotation: the caller checks J itself.
  pure subroutine polar_rotation(f, r)
    real(wp), intent(in) :: f(lanes, 9) !! deformation gradient
    real(wp), intent(out) :: r(lanes, 9)
    integer, parameter :: steps = 20
    real(wp), parameter :: settled = 0.1_wp*sqrt(epsilon(1.0_wp))
    real(wp) :: moving(lanes), scale, det, d, h, change, a1, a2, a3, a4, a5, a6, a7, a8, a9
    integer :: i, k
    !$omp simd simdlen(lanes) private(scale)
    do i = 1, lanes
      scale = 1.0_wp/sqrt(max((f(i, 1)**2 + f(i, 2)**2 + f(i, 3)**2 + f(i, 4)**2 + f(i, 5)**2 + f(i, 6)**2 &
                               + f(i, 7)**2 + f(i, 8)**2 + f(i, 9)**2)/3.0_wp, tiny(1.0_wp)))
      r(i, 1) = f(i, 1)*scale; r(i, 2) = f(i, 2)*scale; r(i, 3) = f(i, 3)*scale
      r(i, 4) = f(i, 4)*scale; r(i, 5) = f(i, 5)*scale; r(i, 6) = f(i, 6)*scale
      r(i, 7) = f(i, 7)*scale; r(i, 8) = f(i, 8)*scale; r(i, 9) = f(i, 9)*scale
      moving(i) = 1.0_wp
    end do
    do k = 1, steps
      !$omp simd simdlen(lanes) private(det, d, h, change, a1, a2, a3, a4, a5, a6, a7, a8, a9)
      do i = 1, lanes
        a1 = r(i, 5)*r(i, 9) - r(i, 6)*r(i, 8) ! cofactors: R^-T = cof R / det R
        a2 = r(i, 6)*r(i, 7) - r(i, 4)*r(i, 9)
        a3 = r(i, 4)*r(i, 8) - r(i, 5)*r(i, 7)
        a4 = r(i, 3)*r(i, 8) - r(i, 2)*r(i, 9)
        a5 = r(i, 1)*r(i, 9) - r(i, 3)*r(i, 7)
        a6 = r(i, 2)*r(i, 7) - r(i, 1)*r(i, 8)
        a7 = r(i, 2)*r(i, 6) - r(i, 3)*r(i, 5)
        a8 = r(i, 3)*r(i, 4) - r(i, 1)*r(i, 6)
        a9 = r(i, 1)*r(i, 5) - r(i, 2)*r(i, 4)
        det = r(i, 1)*a1 + r(i, 2)*a2 + r(i, 3)*a3
        moving(i) = merge(moving(i), 0.0_wp, det > epsilon(1.0_wp)) ! a flat tensor has no rotation: it stays as it is
        d = moving(i)*0.5_wp/max(det, epsilon(1.0_wp))
        h = moving(i)*0.5_wp ! R <- R + (R^-T - R)/2, or nothing
        a1 = d*a1 - h*r(i, 1); a2 = d*a2 - h*r(i, 2); a3 = d*a3 - h*r(i, 3)
        a4 = d*a4 - h*r(i, 4); a5 = d*a5 - h*r(i, 5); a6 = d*a6 - h*r(i, 6)
        a7 = d*a7 - h*r(i, 7); a8 = d*a8 - h*r(i, 8); a9 = d*a9 - h*r(i, 9)
        r(i, 1) = r(i, 1) + a1; r(i, 2) = r(i, 2) + a2; r(i, 3) = r(i, 3) + a3
        r(i, 4) = r(i, 4) + a4; r(i, 5) = r(i, 5) + a5; r(i, 6) = r(i, 6) + a6
        r(i, 7) = r(i, 7) + a7; r(i, 8) = r(i, 8) + a8; r(i, 9) = r(i, 9) + a9
        change = a1*a1 + a2*a2 + a3*a3 + a4*a4 + a5*a5 + a6*a6 + a7*a7 + a8*a8 + a9*a9
        moving(i) = merge(moving(i), 0.0_wp, change > settled**2)
      end do
      if (all(moving < 0.5_wp)) exit
    end do
  end subroutine polar_rotation

  !> x <- ln max(x, tiny): by itself, because a loop that holds only the call becomes one call of the vector logarithm
  pure subroutine natural_log(x)
    real(wp), intent(inout) :: x(lanes)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      x(k) = log(max(x(k), tiny(1.0_wp)))
    end do
  end subroutine natural_log

  !> x <- exp x, by itself for the same reason; |x| is cut short of ln huge so that nothing overflows
  pure subroutine exponential(x)
    real(wp), intent(inout) :: x(lanes)
    real(wp), parameter :: most = 0.986_wp*log(huge(1.0_wp)) ! 700 in double precision, 87 in single
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      x(k) = exp(min(max(x(k), -most), most))
    end do
  end subroutine exponential

end module gimp_tensor
