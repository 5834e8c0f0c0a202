!> Hypoelastic solid: an objective rate of the stress is lambda tr(D) I + 2 mu D (see `gimp_objective_rates`).
!>
!> D and W belong to the middle of the step, the gradient of the grid to its start: the midpoint form (default) takes them of
!> L (I + dt L/2)^-1, the symmetric and the plain form of L as it is given. An increment of F that takes L for that of the
!> middle (Cayley, exponential) leaves nothing to convert.
!>
!> A hypoelastic law has no energy function. What is called stored energy is the stress power, added up by the trapezoidal
!> rule per reference volume: J s:D. It need not come back in a closed cycle. (The logarithmic rate has one, that of Hencky:
!> from the stress-free state the stress power is its growth, to second order in the step.)
module gimp_linear_elastic
  use gimp_kinds, only: wp, lanes
  use gimp_error, only: error_t
  use gimp_text, only: word_in
  use gimp_material, only: material_t
  use gimp_material_options, only: material_options_t, set_elasticity, refuse, complain
  use gimp_objective_rates, only: hughes_winget, plain_hughes_winget, explicit_jaumann, green_naghdi, truesdell, logarithmic, &
    carry_stress, at_middle, wave_modulus
  use gimp_tensor, only: determinant, symmetric_of
  implicit none(type, external)
  private
  public :: linear_elastic_t, make_linear_elastic

  integer, parameter :: stress_states = 7, at_energy = 1, at_stress = 2 !! history: energy, then the stress that the rate carries

  !> The model; needs density, lambda, mu and the rate
  type, extends(material_t) :: linear_elastic_t
    integer :: rate = hughes_winget !! one of `gimp_objective_rates`
    logical :: to_middle = .true. !! take the velocity gradient to the middle of the step
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
    integer :: rate
    logical :: to_middle
    rate = hughes_winget
    select case (options%rate)
    case ("", "hughes_winget")
      if (options%rate_form == "plain") rate = plain_hughes_winget
    case ("jaumann")
      rate = explicit_jaumann
      call refuse(options, "rate_form", "rate = 'jaumann'", error)
    case ("green_naghdi")
      rate = green_naghdi
    case ("truesdell")
      rate = truesdell
    case ("logarithmic")
      rate = logarithmic
    case default
      call complain(options, "rate", "must be hughes_winget, jaumann, green_naghdi, truesdell or logarithmic", error)
    end select
    if (allocated(error)) then
      continue
    else if (word_in(options%rate_form, "midpoint symmetric plain") == 0 .and. options%rate_form /= "") then
      call complain(options, "rate_form", "must be midpoint, symmetric or plain", error)
    else if (options%rate_form == "plain" .and. rate /= plain_hughes_winget) then
      call complain(options, "rate_form", "is for rate = 'hughes_winget'; must be midpoint or symmetric", error)
    end if
    to_middle = rate /= explicit_jaumann .and. .not. options%gradient_of_middle &
      .and. (options%rate_form == "" .or. options%rate_form == "midpoint")
    allocate (material, source=linear_elastic_t(states=stress_states, rate=rate, to_middle=to_middle))
    call set_elasticity(options, material, error)
  end subroutine make_linear_elastic

  !> The initial stress and its elastic energy; F plays no part but for the volume ratio
  pure subroutine start_state(self, f, stress, state)
    class(linear_elastic_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9), stress(lanes, 6)
    real(wp), intent(inout) :: state(lanes, *)
    real(wp) :: j(lanes), weight(lanes), trace
    integer :: k
    call determinant(f, j)
    call weight_of_stress(self%rate, j, weight)
    do k = 1, lanes
      state(k, at_stress:at_stress + 5) = j(k)/weight(k)*stress(k, :)
      trace = sum(state(k, at_stress:at_stress + 2))
      state(k, at_energy) = weight(k)*(sum(state(k, at_stress:at_stress + 2)**2) + 2*sum(state(k, at_stress + 3:at_stress + 5)**2) &
        - self%lambda*trace**2/(3*self%lambda + 2*self%mu))/(4*self%mu)
    end do
  end subroutine start_state

  !> Carry the stress by the objective rate, and add up the stress power
  pure subroutine advance_state(self, dt, l, df, f, state, dissipated)
    class(linear_elastic_t), intent(in) :: self
    real(wp), intent(in) :: dt, l(lanes, 9), df(lanes, 9), f(lanes, 9)
    real(wp), intent(inout) :: state(lanes, *)
    real(wp), intent(out) :: dissipated(lanes)
    real(wp), dimension(lanes) :: power_before, power_after, j, dj, weight, weight_before
    real(wp) :: d(lanes, 6), half(lanes, 6), gradient(lanes, 9)
    integer :: k
    gradient = l
    if (self%to_middle) call at_middle(dt, l, gradient)
    call symmetric_of(gradient, d)
    call half_increment(self%lambda, self%mu, dt, d, half)
    call stress_power(state(1, at_stress), d, power_before)
    call carry_stress(self%rate, dt, gradient, d, df, f, half, state(1, at_stress))
    call stress_power(state(1, at_stress), d, power_after)
    call determinant(f, j)
    call determinant(df, dj)
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      dj(k) = j(k)/merge(dj(k), 1.0_wp, dj(k) > tiny(1.0_wp))
      dissipated(k) = 0.0_wp
    end do
    call weight_of_stress(self%rate, j, weight)
    call weight_of_stress(self%rate, dj, weight_before)
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      state(k, at_energy) = state(k, at_energy) + 0.5_wp*dt*(weight(k)*power_after(k) + weight_before(k)*power_before(k))
    end do
  end subroutine advance_state

  !> What the stress that the rate carries has to be multiplied by to be the Kirchhoff stress: J, or 1 if that is what it is
  pure subroutine weight_of_stress(rate, j, weight)
    integer, intent(in) :: rate
    real(wp), intent(in) :: j(lanes) !! volume ratio
    real(wp), intent(out) :: weight(lanes)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      weight(k) = merge(1.0_wp, j(k), rate == logarithmic)
    end do
  end subroutine weight_of_stress

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
    real(wp) :: j(lanes), weight(lanes), modulus(lanes), per_density
    integer :: c, k
    per_density = 1.0_wp/self%density
    call determinant(f, j)
    call weight_of_stress(self%rate, j, weight)
    call wave_modulus(self%rate, self%lambda, self%mu, state(1, at_stress), modulus)
    do c = 1, 6
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        tau(k, c) = weight(k)*state(k, at_stress + c - 1)
      end do
    end do
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      speed2(k) = per_density*max(weight(k), 0.0_wp)*modulus(k)
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
