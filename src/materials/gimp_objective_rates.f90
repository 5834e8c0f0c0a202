!> Objective rates: a stress carried through one step by  rate(s) = C:D,  C:D = lambda tr(D) I + 2 mu D.
!>
!> With a = dt C:D/2; F_0 and F the deformation gradients of the old and the new step, F = dF F_0, R_0 and R their rotations,
!> R_m and b the rotation and the left Cauchy-Green tensor of (F_0 + F)/2; Q(S) = (I - dt S/2)^-1 (I + dt S/2):
!> - hughes_winget (Jaumann's rate): s <- Q(W) (s + a) Q(W)^T + a;
!> - plain_hughes_winget: s <- Q(W) s Q(W)^T + 2 a (Hughes & Winget 1980); first order when strain and rotation act together;
!> - explicit_jaumann: s <- s + dt (W s - s W) + 2 a; first order, a pure spin makes the deviator grow;
!> - green_naghdi: s <- R (R_0^T s R_0 + R_m^T 2 a R_m) R^T (Dienes 1979; Johnson & Bammann 1984);
!> - truesdell: s <- dF (s + a) dF^T/det dF + a;
!> - logarithmic, of the Kirchhoff stress: t <- Q(S) (t + a) Q(S)^T + a with the spin S = W + sum_(A/=B) c_AB P_A D P_B,
!>   c_AB = (1 + r)/(1 - r) + 2/ln r, r = l_A/l_B, l and P eigenvalues and projections of b (Xiao, Bruhns & Meyers 1997).
!>   From the stress-free state it follows t = lambda tr(h) I + 2 mu h, h = 1/2 ln(F F^T), on any path.
!> All but the second and third are of second order in the step where D and W are those of its middle (see `at_middle`).
!>
!> Wave speed. A wave has the velocity gradient m (x) n; rho Q m is the rate of its traction, and an eigenvalue of Q is at most
!> that of its symmetric part, the largest m.Q m with unit vectors m and n. Let k = (m.n)^2, J2 and p invariants of the
!> stress s (the Kirchhoff stress t and rho0 for the logarithmic rate), X:Y at most sqrt(2 J2) |X'| for Y = s, X' the deviator of X.
!> - Elasticity gives k (lambda + mu) + mu; the spin W gives s:(n (x) n - m (x) m)/2, at most sqrt((1 - k) J2).
!> - Jaumann's rate: lambda + 2 mu + sqrt(J2).
!> - Truesdell's: the stress adds n.s n to every eigenvalue: max(mu, lambda + 2 mu + p) + sqrt(4 J2/3).
!> - The others have the spin W + N, N_AB = c_AB D_AB in axes of b with |c_AB| < 1. N adds s:[D, N], D = sym m (x) n, where
!>   |N x| <= sqrt(1 + k)/2, [D, N] = -sym(m (x) N n) - sym(n (x) N m), m.N n <= |N n| sqrt(1 - k): its norm is at most
!>   sqrt((2 - k)(1 + k)/2). With W, for every k: lambda + 2 mu + (1 + sqrt(2)) sqrt(J2), Green and Naghdi's rate.
!> - The Kirchhoff stress adds -(m.n) m.t n, at right angles to what W gives: together k (lambda + mu - p) + mu and
!>   sqrt((1 + k^2/3) J2), and with N at most max(mu, lambda + 2 mu - p) + 2.58 sqrt(J2), the logarithmic rate.
module gimp_objective_rates
  use gimp_kinds, only: wp, lanes
  use gimp_tensor, only: increment_forward, inverse, multiply, determinant, rotation_cayley, rotate_symmetric, push_forward, &
    left_cauchy_green, eigen_symmetric, natural_log, polar_rotation
  implicit none(type, external)
  private
  public :: hughes_winget, plain_hughes_winget, explicit_jaumann, green_naghdi, truesdell, logarithmic
  public :: carry_stress, at_middle, wave_modulus

  integer, parameter :: hughes_winget = 1, plain_hughes_winget = 2, explicit_jaumann = 3, green_naghdi = 4, truesdell = 5, &
    logarithmic = 6

  !> A step that takes more of the volume than this is about to fail: nothing here may trap before the driver says so
  real(wp), parameter :: least_ratio = 0.01_wp

contains

  !> The stress after one step: Kirchhoff stress for the logarithmic rate, Cauchy stress for all others
  pure subroutine carry_stress(rate, dt, l, d, df, f, a, s)
    integer, intent(in) :: rate !! one of the names above
    real(wp), intent(in) :: dt !! step [s]
    real(wp), intent(in) :: l(lanes, 9) !! velocity gradient, at best that of the middle of the step [1/s]
    real(wp), intent(in) :: d(lanes, 6) !! its symmetric part [1/s]
    real(wp), intent(in) :: df(lanes, 9) !! increment of the deformation gradient
    real(wp), intent(in) :: f(lanes, 9) !! new deformation gradient
    real(wp), intent(in) :: a(lanes, 6) !! dt C:D/2 [Pa]
    real(wp), intent(inout) :: s(lanes, 6) !! [Pa]
    real(wp) :: q(lanes, 9), spin(lanes, 9)
    select case (rate)
    case (hughes_winget)
      call rotation_cayley(dt, l, q)
      call add(a, 1.0_wp, s)
      call rotate_symmetric(q, s)
      call add(a, 1.0_wp, s)
    case (plain_hughes_winget)
      call rotation_cayley(dt, l, q)
      call rotate_symmetric(q, s)
      call add(a, 2.0_wp, s)
    case (explicit_jaumann)
      call add_spin(dt, l, s)
      call add(a, 2.0_wp, s)
    case (green_naghdi)
      call carry_with_rotation(df, f, a, s)
    case (truesdell)
      call add(a, 1.0_wp, s)
      call rotate_symmetric(df, s)
      call per_volume(df, s)
      call add(a, 1.0_wp, s)
    case (logarithmic)
      call logarithmic_spin(l, d, df, f, spin)
      call rotation_cayley(dt, spin, q)
      call add(a, 1.0_wp, s)
      call rotate_symmetric(q, s)
      call add(a, 1.0_wp, s)
    end select
  end subroutine carry_stress

  !> L (I + dt L/2)^-1: the velocity gradient with respect to the positions of the middle of the step, from that with respect
  !> to those of its start
  pure subroutine at_middle(dt, l, middle)
    real(wp), intent(in) :: dt !! step [s]
    real(wp), intent(in) :: l(lanes, 9) !! [1/s]
    real(wp), intent(out) :: middle(lanes, 9) !! [1/s]
    real(wp) :: half_way(lanes, 9), back(lanes, 9), det(lanes)
    integer :: c, k
    call increment_forward(0.5_wp*dt, l, half_way)
    call determinant(half_way, det)
    call inverse(half_way, back)
    call multiply(l, back, middle)
    do c = 1, 9
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        middle(k, c) = merge(middle(k, c), l(k, c), det(k) > least_ratio)
      end do
    end do
  end subroutine at_middle

  !> An upper bound of rho c^2, or of rho0 c^2 for the logarithmic rate; derived above
  pure subroutine wave_modulus(rate, lambda, mu, s, modulus)
    integer, intent(in) :: rate
    real(wp), intent(in) :: lambda, mu !! Lame constants [Pa]
    real(wp), intent(in) :: s(lanes, 6) !! the stress that the rate carries [Pa]
    real(wp), intent(out) :: modulus(lanes) !! [Pa]
    real(wp), parameter :: third = 1.0_wp/3.0_wp
    real(wp) :: of_p, of_root ! factors of the mean stress and of sqrt(J2)
    integer :: k
    of_p = 0.0_wp
    of_root = 1.0_wp
    select case (rate)
    case (green_naghdi)
      of_root = 1.0_wp + sqrt(2.0_wp)
    case (truesdell)
      of_p = 1.0_wp
      of_root = sqrt(4.0_wp*third)
    case (logarithmic)
      of_p = -1.0_wp
      of_root = 2.58_wp
    end select
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: p, j2
        p = third*(s(k, 1) + s(k, 2) + s(k, 3))
        j2 = 0.5_wp*((s(k, 1) - p)**2 + (s(k, 2) - p)**2 + (s(k, 3) - p)**2) + s(k, 4)**2 + s(k, 5)**2 + s(k, 6)**2
        modulus(k) = max(mu, lambda + 2.0_wp*mu + of_p*p) + of_root*sqrt(j2)
      end block
    end do
  end subroutine wave_modulus

  !> s <- R (R_0^T s R_0 + R_m^T 2 a R_m) R^T
  pure subroutine carry_with_rotation(df, f, a, s)
    real(wp), intent(in) :: df(lanes, 9), f(lanes, 9), a(lanes, 6)
    real(wp), intent(inout) :: s(lanes, 6)
    real(wp) :: start(lanes, 9), middle(lanes, 9), r(lanes, 9), increment(lanes, 6)
    call earlier(df, f, start, middle)
    call polar_rotation(start, r)
    call transpose_of(r)
    call rotate_symmetric(r, s)
    call polar_rotation(middle, r)
    call transpose_of(r)
    call push_forward(r, a, increment)
    call add(increment, 2.0_wp, s)
    call polar_rotation(f, r)
    call rotate_symmetric(r, s)
  end subroutine carry_with_rotation

  !> F of the start of the step, dF^-1 F, and the mean of it and F
  pure subroutine earlier(df, f, start, middle)
    real(wp), intent(in) :: df(lanes, 9), f(lanes, 9)
    real(wp), intent(out) :: start(lanes, 9), middle(lanes, 9)
    real(wp) :: back(lanes, 9), det(lanes)
    integer :: c, k
    call determinant(df, det)
    call inverse(df, back)
    call multiply(back, f, start)
    do c = 1, 9
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        start(k, c) = merge(start(k, c), f(k, c), det(k) > least_ratio)
        middle(k, c) = 0.5_wp*(start(k, c) + f(k, c))
      end do
    end do
  end subroutine earlier

  !> W + sum_(A/=B) c_AB P_A D P_B
  pure subroutine logarithmic_spin(l, d, df, f, spin)
    real(wp), intent(in) :: l(lanes, 9), d(lanes, 6), df(lanes, 9), f(lanes, 9)
    real(wp), intent(out) :: spin(lanes, 9)
    real(wp) :: start(lanes, 9), middle(lanes, 9), b(lanes, 6), values(lanes, 3), logs(lanes, 3), n(lanes, 9), turned(lanes, 6)
    real(wp) :: c(lanes, 3)
    integer :: i, k
    call earlier(df, f, start, middle)
    call left_cauchy_green(middle, b)
    call eigen_symmetric(b, values, n)
    do i = 1, 3
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        logs(k, i) = values(k, i)
      end do
      call natural_log(logs(:, i))
    end do
    do i = 1, 3 ! pairs 12, 23, 31
      k = mod(i, 3) + 1
      call spin_factor(values(:, i), values(:, k), logs(:, i), logs(:, k), c(:, i))
    end do
    middle = n
    call transpose_of(middle)
    call push_forward(middle, d, turned) ! D in the axes of b
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: x, y, z, u, v, w ! axial vector of the added spin in the axes of b, and in space
        x = -c(k, 2)*turned(k, 5)
        y = -c(k, 3)*turned(k, 6)
        z = -c(k, 1)*turned(k, 4)
        u = n(k, 1)*x + n(k, 2)*y + n(k, 3)*z
        v = n(k, 4)*x + n(k, 5)*y + n(k, 6)*z
        w = n(k, 7)*x + n(k, 8)*y + n(k, 9)*z
        spin(k, 1) = 0.0_wp
        spin(k, 2) = 0.5_wp*(l(k, 2) - l(k, 4)) - w
        spin(k, 3) = 0.5_wp*(l(k, 3) - l(k, 7)) + v
        spin(k, 4) = -spin(k, 2)
        spin(k, 5) = 0.0_wp
        spin(k, 6) = 0.5_wp*(l(k, 6) - l(k, 8)) - u
        spin(k, 7) = -spin(k, 3)
        spin(k, 8) = -spin(k, 6)
        spin(k, 9) = 0.0_wp
      end block
    end do
  end subroutine logarithmic_spin

  !> c = (1 + r)/(1 - r) + 2/ln r, r = a/b, which is 1/x - coth x with x = (ln r)/2
  !>
  !> Up to |x| = 1 by Lambert's continued fraction coth x - 1/x = x/(3 + x^2/(5 + ... x^2/17)), written as one quotient: the
  !> terms of the formula cancel there, and two equal eigenvalues are no special case. It leaves out 10^-16 of c.
  pure subroutine spin_factor(a, b, log_a, log_b, c)
    real(wp), intent(in) :: a(lanes), b(lanes) !! eigenvalues
    real(wp), intent(in) :: log_a(lanes), log_b(lanes) !! their logarithms
    real(wp), intent(out) :: c(lanes)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: x, w, near, far, difference
        x = 0.5_wp*(log_a(k) - log_b(k))
        w = min(x*x, 1.0_wp)
        near = -x*(11486475.0_wp + w*(810810.0_wp + w*(12870.0_wp + w*44.0_wp))) &
          /(34459425.0_wp + w*(4729725.0_wp + w*(135135.0_wp + w*(990.0_wp + w))))
        difference = b(k) - a(k)
        far = (a(k) + b(k))/merge(difference, 1.0_wp, x*x > 1.0_wp) + 1.0_wp/merge(x, 1.0_wp, x*x > 1.0_wp)
        c(k) = merge(far, near, x*x > 1.0_wp)
      end block
    end do
  end subroutine spin_factor

  !> A <- A^T
  pure subroutine transpose_of(a)
    real(wp), intent(inout) :: a(lanes, 9)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: a12, a13, a23
        a12 = a(k, 2)
        a13 = a(k, 3)
        a23 = a(k, 6)
        a(k, 2) = a(k, 4)
        a(k, 3) = a(k, 7)
        a(k, 6) = a(k, 8)
        a(k, 4) = a12
        a(k, 7) = a13
        a(k, 8) = a23
      end block
    end do
  end subroutine transpose_of

  !> s <- s/det dF
  pure subroutine per_volume(df, s)
    real(wp), intent(in) :: df(lanes, 9)
    real(wp), intent(inout) :: s(lanes, 6)
    real(wp) :: det(lanes), ratio(lanes)
    integer :: c, k
    call determinant(df, det)
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      ratio(k) = 1.0_wp/max(det(k), least_ratio)
    end do
    do c = 1, 6
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        s(k, c) = ratio(k)*s(k, c)
      end do
    end do
  end subroutine per_volume

  !> s <- s + factor a
  pure subroutine add(a, factor, s)
    real(wp), intent(in) :: a(lanes, 6), factor
    real(wp), intent(inout) :: s(lanes, 6)
    integer :: c, k
    do c = 1, 6
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        s(k, c) = s(k, c) + factor*a(k, c)
      end do
    end do
  end subroutine add

  !> s <- s + dt (W s - s W), W = skw L
  pure subroutine add_spin(dt, l, s)
    real(wp), intent(in) :: dt, l(lanes, 9)
    real(wp), intent(inout) :: s(lanes, 6)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: w12, w23, w31, s1, s2, s3, s4, s5, s6
        w12 = 0.5_wp*dt*(l(k, 2) - l(k, 4))
        w23 = 0.5_wp*dt*(l(k, 6) - l(k, 8))
        w31 = 0.5_wp*dt*(l(k, 7) - l(k, 3))
        s1 = s(k, 1)
        s2 = s(k, 2)
        s3 = s(k, 3)
        s4 = s(k, 4)
        s5 = s(k, 5)
        s6 = s(k, 6)
        s(k, 1) = s1 + 2.0_wp*(w12*s4 - w31*s6)
        s(k, 2) = s2 + 2.0_wp*(w23*s5 - w12*s4)
        s(k, 3) = s3 + 2.0_wp*(w31*s6 - w23*s5)
        s(k, 4) = s4 + w12*(s2 - s1) - w31*s5 + w23*s6
        s(k, 5) = s5 + w23*(s3 - s2) - w12*s6 + w31*s4
        s(k, 6) = s6 + w31*(s1 - s3) - w23*s4 + w12*s5
      end block
    end do
  end subroutine add_spin

end module gimp_objective_rates
