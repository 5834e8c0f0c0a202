!> Hypoelastic solid: an objective rate of the Cauchy stress is lambda tr(D) I + 2 mu D.
!>
!> Rates, with a = dt (lambda tr(D) I + 2 mu D)/2 and D, W of the velocity gradient given:
!> - hughes_winget, midpoint (default): s <- Q (s + a) Q^T + a, Q = (I - dt W/2)^-1 (I + dt W/2), with D and W of
!>   L (I + dt L/2)^-1: the gradient of the grid refers to x_n, this one to x_n+1/2; second order;
!> - hughes_winget, symmetric: the same with L as given; second order where L is that of the middle of the step;
!> - hughes_winget, plain (Hughes & Winget 1980): s <- Q s Q^T + 2 a; first order when strain and rotation act together;
!> - jaumann: s <- s + dt (W s - s W) + 2 a; first order, a pure spin makes the deviator grow: for comparison only.
!>
!> A hypoelastic law has no energy function. What is called stored energy is the stress power, added up by the trapezoidal
!> rule per reference volume: J s:D. It need not come back in a closed cycle.
!>
!> Wave speed. For the velocity gradient a (x) n of a wave the traction rate is
!>   rho Q a = (lambda + mu) n (n.a) + mu a + [ (n.s n) I - s + s n (x) n - n (x) s n ] a/2;
!> the last pair is skew, so rho c^2 <= lambda + 2 mu + (s1 - s3)/2 <= lambda + 2 mu + sqrt(J2), and rho = rho0/J.
module gimp_linear_elastic
  use gimp_kinds, only: wp, lanes
  use gimp_error, only: error_t
  use gimp_material, only: material_t
  use gimp_material_options, only: material_options_t, set_elasticity, refuse, complain
  use gimp_tensor, only: increment_forward, inverse, multiply, determinant, symmetric_of, rotation_cayley, rotate_symmetric
  implicit none(type, external)
  private
  public :: linear_elastic_t, make_linear_elastic, symmetric_hughes_winget, plain_hughes_winget, explicit_jaumann, &
    midpoint_hughes_winget

  integer, parameter :: symmetric_hughes_winget = 1, plain_hughes_winget = 2, explicit_jaumann = 3, midpoint_hughes_winget = 4
  integer, parameter :: stress_states = 7, at_energy = 1, at_stress = 2 !! history: energy, then the Cauchy stress

  !> The model; needs density, lambda, mu and the scheme
  type, extends(material_t) :: linear_elastic_t
    integer :: scheme = midpoint_hughes_winget !! how the stress is carried
  contains
    procedure :: start_state
    procedure :: advance_state
    procedure :: kirchhoff
    procedure :: stored_energy
  end type linear_elastic_t

contains

  !> From the options of a scene
  subroutine make_linear_elastic(options, material, error)
    type(material_options_t), intent(in) :: options
    class(material_t), allocatable, intent(out) :: material
    type(error_t), allocatable, intent(out) :: error
    integer :: scheme
    scheme = midpoint_hughes_winget
    select case (options%rate)
    case ("", "hughes_winget")
      select case (options%rate_form)
      case ("", "midpoint")
      case ("symmetric")
        scheme = symmetric_hughes_winget
      case ("plain")
        scheme = plain_hughes_winget
      case default
        call complain(options, "rate_form", "must be midpoint, symmetric or plain", error)
      end select
    case ("jaumann")
      scheme = explicit_jaumann
      call refuse(options, "rate_form", "rate = 'jaumann'", error)
    case default
      call complain(options, "rate", "must be hughes_winget or jaumann", error)
    end select
    allocate (material, source=linear_elastic_t(states=stress_states, scheme=scheme))
    call set_elasticity(options, material, error)
  end subroutine make_linear_elastic

  !> The initial stress and its elastic energy; F plays no part but for the volume ratio
  pure subroutine start_state(self, f, stress, state)
    class(linear_elastic_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9), stress(lanes, 6)
    real(wp), intent(inout) :: state(lanes, *)
    real(wp) :: j(lanes), trace
    integer :: k
    call determinant(f, j)
    do k = 1, lanes
      state(k, at_stress:at_stress + 5) = stress(k, :)
      trace = sum(stress(k, 1:3))
      state(k, at_energy) = j(k)*(sum(stress(k, 1:3)**2) + 2*sum(stress(k, 4:6)**2) &
        - self%lambda*trace**2/(3*self%lambda + 2*self%mu))/(4*self%mu)
    end do
  end subroutine start_state

  !> Carry the Cauchy stress by the objective rate, and add up the stress power
  pure subroutine advance_state(self, dt, l, df, f, state, dissipated)
    class(linear_elastic_t), intent(in) :: self
    real(wp), intent(in) :: dt, l(lanes, 9), df(lanes, 9), f(lanes, 9)
    real(wp), intent(inout) :: state(lanes, *)
    real(wp), intent(out) :: dissipated(lanes)
    real(wp) :: d(lanes, 6), half(lanes, 6), q(lanes, 9), rate(lanes, 9), power_before(lanes), power_after(lanes), j(lanes), dj(lanes)
    integer :: k
    rate = l
    if (self%scheme == midpoint_hughes_winget) call at_middle(dt, l, rate)
    call symmetric_of(rate, d)
    call half_increment(self%lambda, self%mu, dt, d, half)
    call stress_power(state(1, at_stress), d, power_before)
    select case (self%scheme)
    case (symmetric_hughes_winget, midpoint_hughes_winget)
      call rotation_cayley(dt, rate, q)
      call add(half, 1.0_wp, state(1, at_stress))
      call rotate_symmetric(q, state(1, at_stress))
      call add(half, 1.0_wp, state(1, at_stress))
    case (plain_hughes_winget)
      call rotation_cayley(dt, l, q)
      call rotate_symmetric(q, state(1, at_stress))
      call add(half, 2.0_wp, state(1, at_stress))
    case (explicit_jaumann)
      call add_spin(dt, l, state(1, at_stress))
      call add(half, 2.0_wp, state(1, at_stress))
    end select
    call stress_power(state(1, at_stress), d, power_after)
    call determinant(f, j)
    call determinant(df, dj)
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      state(k, at_energy) = state(k, at_energy) + 0.5_wp*dt*j(k)*(power_after(k) &
        + power_before(k)/merge(dj(k), 1.0_wp, dj(k) > tiny(1.0_wp)))
      dissipated(k) = 0.0_wp
    end do
  end subroutine advance_state

  !> L (I + dt L/2)^-1: the velocity gradient with respect to the positions of the middle of the step
  pure subroutine at_middle(dt, l, middle)
    real(wp), intent(in) :: dt, l(lanes, 9)
    real(wp), intent(out) :: middle(lanes, 9)
    real(wp) :: half_way(lanes, 9), back(lanes, 9), det(lanes)
    integer :: c, k
    call increment_forward(0.5_wp*dt, l, half_way)
    call determinant(half_way, det)
    call inverse(half_way, back)
    call multiply(l, back, middle)
    do c = 1, 9 ! a step that turns the half way inside out is about to fail: nothing here may trap before the driver says so
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        middle(k, c) = merge(middle(k, c), l(k, c), det(k) > 0.01_wp)
      end do
    end do
  end subroutine at_middle

  !> dt (lambda tr(D) I + 2 mu D)/2
  pure subroutine half_increment(lambda, mu, dt, d, half)
    real(wp), intent(in) :: lambda, mu !! [Pa]
    real(wp), intent(in) :: dt !! [s]
    real(wp), intent(in) :: d(lanes, 6) !! rate of deformation [1/s]
    real(wp), intent(out) :: half(lanes, 6) !! [Pa]
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: volumetric
        volumetric = 0.5_wp*dt*lambda*(d(k, 1) + d(k, 2) + d(k, 3))
        half(k, 1) = volumetric + dt*mu*d(k, 1)
        half(k, 2) = volumetric + dt*mu*d(k, 2)
        half(k, 3) = volumetric + dt*mu*d(k, 3)
        half(k, 4) = dt*mu*d(k, 4)
        half(k, 5) = dt*mu*d(k, 5)
        half(k, 6) = dt*mu*d(k, 6)
      end block
    end do
  end subroutine half_increment

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

  !> s:D [W/m3]
  pure subroutine stress_power(s, d, power)
    real(wp), intent(in) :: s(lanes, 6), d(lanes, 6)
    real(wp), intent(out) :: power(lanes)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      power(k) = s(k, 1)*d(k, 1) + s(k, 2)*d(k, 2) + s(k, 3)*d(k, 3) &
        + 2.0_wp*(s(k, 4)*d(k, 4) + s(k, 5)*d(k, 5) + s(k, 6)*d(k, 6))
    end do
  end subroutine stress_power

  !> tau = J sigma and the bound of the wave speed
  pure subroutine kirchhoff(self, f, state, tau, speed2)
    class(linear_elastic_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: tau(lanes, 6)
    real(wp), intent(out) :: speed2(lanes)
    real(wp) :: j(lanes), modulus, per_density
    integer :: k
    modulus = self%lambda + 2*self%mu
    per_density = 1.0_wp/self%density
    call determinant(f, j)
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: p, j2, s1, s2, s3, s4, s5, s6
        s1 = state(k, at_stress)
        s2 = state(k, at_stress + 1)
        s3 = state(k, at_stress + 2)
        s4 = state(k, at_stress + 3)
        s5 = state(k, at_stress + 4)
        s6 = state(k, at_stress + 5)
        p = (s1 + s2 + s3)/3.0_wp
        j2 = 0.5_wp*((s1 - p)**2 + (s2 - p)**2 + (s3 - p)**2) &
          + s4**2 + s5**2 + s6**2
        tau(k, 1) = j(k)*s1
        tau(k, 2) = j(k)*s2
        tau(k, 3) = j(k)*s3
        tau(k, 4) = j(k)*s4
        tau(k, 5) = j(k)*s5
        tau(k, 6) = j(k)*s6
        speed2(k) = per_density*max(j(k), 0.0_wp)*(modulus + sqrt(j2))
      end block
    end do
  end subroutine kirchhoff

  !> The stress power added up so far
  pure subroutine stored_energy(self, f, state, energy)
    class(linear_elastic_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: energy(lanes)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      energy(k) = state(k, at_energy)
    end do
  end subroutine stored_energy

end module gimp_linear_elastic
