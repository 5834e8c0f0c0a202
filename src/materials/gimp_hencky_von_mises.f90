!> Metal plasticity on logarithmic strain: Hencky elasticity, von Mises yield in the Kirchhoff stress, isotropic hardening.
!>
!> q = sqrt(3/2) |dev tau| <= sy(ep), associated flow. Return (Simo & Hughes 1998, box 3.1; de Souza Neto,
!> Peric & Owen 2008, ch. 7 and 14): q_tr - 3 mu g = sy(ep + g), dev e scaled by 1 - 3 mu g/q_tr, ep grows by g.
!> Hardening: none, sy; linear, sy + H ep; power, sy (1 + ep/e0)^n (Swift).
!> The return is applied at t = 0 too, so that a body which starts strained starts inside the yield surface.
module gimp_hencky_von_mises
  use gimp_kinds, only: wp, dp, lanes
  use gimp_error, only: error_t
  use gimp_material, only: material_t
  use gimp_material_options, only: material_options_t, set_elasticity, is_set, need, refuse, demand_above, &
    demand_at_least, demand_within, complain
  use gimp_tensor, only: natural_log, exponential
  use gimp_log_strain, only: plastic_states, at_plastic_strain, at_strain, starting_strain, trial_strain, &
    kirchhoff_of_strain, elastic_energy, wave_bound
  implicit none(type, external)
  private
  public :: hencky_von_mises_t, make_hencky_von_mises, linear_hardening, power_hardening

  integer, parameter :: linear_hardening = 1, power_hardening = 2

  !> The model; needs density, lambda, mu, the yield stress and the hardening
  type, extends(material_t) :: hencky_von_mises_t
    integer :: hardening = linear_hardening
    real(wp) :: yield_stress = 0.0_wp !! sy at ep = 0 [Pa]
    real(wp) :: modulus = 0.0_wp !! H of linear hardening [Pa]
    real(wp) :: exponent = 0.0_wp !! n of power hardening
    real(wp) :: strain = 1.0_wp !! e0 of power hardening
  contains
    procedure :: start_state
    procedure :: advance_state
    procedure :: kirchhoff
    procedure :: stored_energy
    procedure :: equivalent_plastic_strain
  end type hencky_von_mises_t

contains

  !> From the options of a scene
  subroutine make_hencky_von_mises(options, material, error)
    type(material_options_t), intent(in) :: options
    class(material_t), allocatable, intent(out) :: material
    type(error_t), allocatable, intent(out) :: error
    type(hencky_von_mises_t) :: made
    logical :: linear, power
    call demand_above(options, "yield_stress", 0.0_dp, error)
    linear = options%hardening == "linear"
    power = options%hardening == "power"
    if (.not. (linear .or. power .or. options%hardening == "none" .or. options%hardening == "")) &
      call complain(options, "hardening", "must be none, linear or power", error)
    if (.not. linear) call refuse(options, "hardening_modulus", "this hardening", error)
    if (power) then
      call need(options, "hardening_strain", "hardening = 'power'", error)
    else
      call refuse(options, "hardening_exponent", "this hardening", error)
      call refuse(options, "hardening_strain", "this hardening", error)
    end if
    if (.not. allocated(error)) then
      made%states = plastic_states
      made%yield_stress = real(options%yield_stress, wp)
      if (linear .and. is_set(options, "hardening_modulus")) then
        call demand_at_least(options, "hardening_modulus", 0.0_dp, error)
        made%modulus = real(options%hardening_modulus, wp)
      else if (power) then
        call demand_above(options, "hardening_strain", 0.0_dp, error)
        made%hardening = power_hardening
        made%strain = real(options%hardening_strain, wp)
        made%exponent = 1
        if (is_set(options, "hardening_exponent")) then
          call demand_within(options, "hardening_exponent", 0.0_dp, 1.0_dp, error)
          made%exponent = real(options%hardening_exponent, wp)
        end if
      end if
    end if
    allocate (material, source=made)
    call set_elasticity(options, material, error)
  end subroutine make_hencky_von_mises

  !> The elastic strain of F (or of an initial stress), returned to the yield surface
  pure subroutine start_state(self, f, stress, state)
    class(hencky_von_mises_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9), stress(lanes, 6)
    real(wp), intent(inout) :: state(lanes, *)
    real(wp) :: e(lanes, 6), work(lanes)
    integer :: k
    call starting_strain(self%lambda, self%mu, f, stress, e)
    do k = 1, lanes
      state(k, at_plastic_strain) = 0.0_wp
    end do
    call return_strain(self, e, state, work)
  end subroutine start_state

  !> Push b_e forward and return it to the yield surface
  pure subroutine advance_state(self, dt, l, df, f, state, dissipated)
    class(hencky_von_mises_t), intent(in) :: self
    real(wp), intent(in) :: dt, l(lanes, 9), df(lanes, 9), f(lanes, 9)
    real(wp), intent(inout) :: state(lanes, *)
    real(wp), intent(out) :: dissipated(lanes)
    real(wp) :: e(lanes, 6)
    call trial_strain(df, state(1, at_strain), e)
    call return_strain(self, e, state, dissipated)
  end subroutine advance_state

  !> Return the trial strain and store it
  pure subroutine return_strain(self, e, state, work)
    class(hencky_von_mises_t), intent(in) :: self
    real(wp), intent(in) :: e(lanes, 6) !! trial strain
    real(wp), intent(inout) :: state(lanes, *)
    real(wp), intent(out) :: work(lanes) !! plastic work: the mean flow stress times the growth of ep [J/m3]
    real(wp), parameter :: third = 1.0_wp/3.0_wp
    real(wp) :: q(lanes), ep(lanes), g(lanes), mean(lanes), mu
    integer :: k
    mu = self%mu
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      mean(k) = third*(e(k, 1) + e(k, 2) + e(k, 3))
      q(k) = mu*sqrt(6.0_wp*((e(k, 1) - mean(k))**2 + (e(k, 2) - mean(k))**2 + (e(k, 3) - mean(k))**2 &
        + 2.0_wp*(e(k, 4)*e(k, 4) + e(k, 5)*e(k, 5) + e(k, 6)*e(k, 6))))
      ep(k) = state(k, at_plastic_strain)
    end do
    if (self%hardening == power_hardening) then
      call flow_power(mu, self%yield_stress, self%exponent, self%strain, q, ep, g, work)
    else
      call flow_linear(mu, self%yield_stress, self%modulus, q, ep, g, work)
    end if
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: scale
        scale = 1.0_wp - 3.0_wp*mu*g(k)/max(q(k), tiny(1.0_wp))
        state(k, at_plastic_strain) = ep(k) + g(k)
        state(k, at_strain) = mean(k) + scale*(e(k, 1) - mean(k))
        state(k, at_strain + 1) = mean(k) + scale*(e(k, 2) - mean(k))
        state(k, at_strain + 2) = mean(k) + scale*(e(k, 3) - mean(k))
        state(k, at_strain + 3) = scale*e(k, 4)
        state(k, at_strain + 4) = scale*e(k, 5)
        state(k, at_strain + 5) = scale*e(k, 6)
      end block
    end do
  end subroutine return_strain

  !> Linear hardening: closed form
  pure subroutine flow_linear(mu, sy, h, q, ep, g, work)
    real(wp), intent(in) :: mu, sy, h !! shear modulus, yield stress, hardening modulus [Pa]
    real(wp), intent(in) :: q(lanes) !! trial equivalent stress [Pa]
    real(wp), intent(in) :: ep(lanes) !! plastic strain before
    real(wp), intent(out) :: g(lanes) !! its growth
    real(wp), intent(out) :: work(lanes) !! [J/m3]
    real(wp) :: per_stiffness
    integer :: k
    per_stiffness = 1.0_wp/(3.0_wp*mu + h)
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      g(k) = per_stiffness*max(0.0_wp, q(k) - sy - h*ep(k))
      work(k) = g(k)*(sy + h*(ep(k) + 0.5_wp*g(k)))
    end do
  end subroutine flow_linear

  !> Power hardening: Newton's method on r(g) = q - 3 mu g - sy (1 + (ep + g)/e0)^n
  !>
  !> For 0 <= n <= 1 r is convex and falls, so that from g = 0 the iterates rise to the root without passing it; the cut to
  !> [0, q/(3 mu)] guards against round-off. A lane that has arrived stays, so no result depends on its neighbours.
  pure subroutine flow_power(mu, sy, exponent, strain, q, ep, g, work)
    real(wp), intent(in) :: mu, sy !! shear modulus, yield stress [Pa]
    real(wp), intent(in) :: exponent, strain !! n and e0
    real(wp), intent(in) :: q(lanes) !! trial equivalent stress [Pa]
    real(wp), intent(in) :: ep(lanes) !! plastic strain before
    real(wp), intent(out) :: g(lanes) !! its growth
    real(wp), intent(out) :: work(lanes) !! trapezoidal: third order in g [J/m3]
    integer, parameter :: most = 60 !! far more than needed: the slowest of 3 10^5 random cases took 10
    real(wp) :: before(lanes), flow(lanes), residual(lanes)
    integer :: iteration, k
    g = 0.0_wp
    call flow_stress(sy, exponent, strain, ep, g, before)
    flow = before
    do iteration = 1, most
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        residual(k) = q(k) - 3.0_wp*mu*g(k) - flow(k)
        residual(k) = merge(residual(k), 0.0_wp, residual(k) > 4.0_wp*epsilon(1.0_wp)*q(k))
        g(k) = min(g(k) + residual(k)/(3.0_wp*mu + exponent*flow(k)/(strain + ep(k) + g(k))), q(k)/(3.0_wp*mu))
      end do
      if (maxval(residual) <= 0.0_wp) exit
      call flow_stress(sy, exponent, strain, ep, g, flow)
    end do
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      work(k) = 0.5_wp*g(k)*(before(k) + flow(k))
    end do
  end subroutine flow_power

  !> sy (1 + (ep + g)/e0)^n
  pure subroutine flow_stress(sy, exponent, strain, ep, g, flow)
    real(wp), intent(in) :: sy, exponent, strain, ep(lanes), g(lanes)
    real(wp), intent(out) :: flow(lanes)
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      flow(k) = 1.0_wp + (ep(k) + g(k))/strain
    end do
    call natural_log(flow)
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      flow(k) = exponent*flow(k)
    end do
    call exponential(flow)
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      flow(k) = sy*flow(k)
    end do
  end subroutine flow_stress

  !> The stress of the last return, and the bound of the elastic wave speed (plastic flow only slows waves)
  pure subroutine kirchhoff(self, f, state, tau, speed2)
    class(hencky_von_mises_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: tau(lanes, 6)
    real(wp), intent(out) :: speed2(lanes)
    call kirchhoff_of_strain(self%lambda, self%mu, state(1, at_strain), tau)
    call wave_bound(self%lambda, self%mu, self%density, tau, speed2)
  end subroutine kirchhoff

  !> The elastic part; the work spent on hardening counts as dissipated
  pure subroutine stored_energy(self, f, state, energy)
    class(hencky_von_mises_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: energy(lanes)
    call elastic_energy(self%lambda, self%mu, state(1, at_strain), energy)
  end subroutine stored_energy

  !> ep, the time integral of sqrt(2/3 Dp:Dp)
  pure subroutine equivalent_plastic_strain(self, state, ep)
    class(hencky_von_mises_t), intent(in) :: self
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: ep(lanes)
    ep = state(:, at_plastic_strain)
  end subroutine equivalent_plastic_strain

end module gimp_hencky_von_mises
