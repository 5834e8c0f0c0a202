!> Frictional solid on logarithmic strain: Hencky elasticity, Drucker-Prager cone in the Kirchhoff stress, perfectly plastic.
!>
!> f = sqrt(J2) + eta p - xi c, p = tr(tau)/3 (tension positive), flow potential sqrt(J2) + etabar p. Return
!> (de Souza Neto, Peric & Owen 2008, ch. 8.3): to the cone, g = f/(mu + K eta etabar), and to the apex p = xi c/eta where
!> that would make sqrt(J2) negative. The cone goes through a Mohr-Coulomb surface in plane strain (default), at the outer
!> (compression) edges or at the inner (extension) edges. Without friction it is a cylinder and has no apex.
module gimp_drucker_prager
  use gimp_kinds, only: wp, dp, lanes, pi
  use gimp_error, only: error_t
  use gimp_material, only: material_t
  use gimp_material_options, only: material_options_t, set_elasticity, is_set, demand_at_least, demand_within, complain
  use gimp_log_strain, only: plastic_states, at_plastic_strain, at_strain, starting_strain, trial_strain, &
    kirchhoff_of_strain, elastic_energy, wave_bound
  implicit none(type, external)
  private
  public :: drucker_prager_t, make_drucker_prager

  !> The model; needs density, lambda, mu and the cone
  type, extends(material_t) :: drucker_prager_t
    real(wp) :: eta = 0.0_wp !! slope of the cone over p
    real(wp) :: eta_bar = 0.0_wp !! slope of the flow potential over p
    real(wp) :: strength = 0.0_wp !! xi c: sqrt(J2) at yield without pressure [Pa]
  contains
    procedure :: start_state
    procedure :: advance_state
    procedure :: kirchhoff
    procedure :: stored_energy
    procedure :: equivalent_plastic_strain
  end type drucker_prager_t

contains

  !> From the options of a scene
  subroutine make_drucker_prager(options, material, error)
    type(material_options_t), intent(in) :: options
    class(material_t), allocatable, intent(out) :: material
    type(error_t), allocatable, intent(out) :: error
    type(drucker_prager_t) :: made
    character(len=32) :: cone
    real(dp) :: eta, xi, cohesion
    cohesion = 0
    if (is_set(options, "cohesion")) then
      cohesion = options%cohesion
      call demand_at_least(options, "cohesion", 0.0_dp, error)
    end if
    call demand_within(options, "friction_angle", 0.0_dp, 89.0_dp, error)
    if (is_set(options, "dilation_angle")) &
      call demand_within(options, "dilation_angle", 0.0_dp, max(0.0_dp, options%friction_angle), error)
    if (cohesion == 0.0_dp .and. options%friction_angle == 0.0_dp) &
      call complain(options, "friction_angle", "must be above 0 where cohesion is 0", error)
    cone = options%cone
    if (cone == "") cone = "plane_strain"
    if (.not. (cone == "plane_strain" .or. cone == "outer" .or. cone == "inner")) &
      call complain(options, "cone", "must be plane_strain, outer or inner", error)
    if (.not. allocated(error)) then
      call cone_slopes(cone, options%friction_angle, eta, xi)
      made%eta = real(eta, wp)
      made%strength = real(xi*cohesion, wp)
      if (is_set(options, "dilation_angle")) then
        call cone_slopes(cone, options%dilation_angle, eta, xi)
        made%eta_bar = real(eta, wp)
      end if
      made%states = plastic_states
    end if
    allocate (material, source=made)
    call set_elasticity(options, material, error)
  end subroutine make_drucker_prager

  !> eta and xi of a cone through the Mohr-Coulomb surface
  pure subroutine cone_slopes(cone, angle, eta, xi)
    character(len=*), intent(in) :: cone !! plane_strain, outer or inner
    real(dp), intent(in) :: angle !! [degree]
    real(dp), intent(out) :: eta, xi
    real(dp) :: s, c, t
    s = sin(angle*pi/180)
    c = cos(angle*pi/180)
    t = tan(angle*pi/180)
    select case (cone)
    case ("outer")
      eta = 6*s/(sqrt(3.0_dp)*(3 - s))
      xi = 6*c/(sqrt(3.0_dp)*(3 - s))
    case ("inner")
      eta = 6*s/(sqrt(3.0_dp)*(3 + s))
      xi = 6*c/(sqrt(3.0_dp)*(3 + s))
    case default
      eta = 3*t/sqrt(9 + 12*t*t)
      xi = 3/sqrt(9 + 12*t*t)
    end select
  end subroutine cone_slopes

  !> The elastic strain of F (or of an initial stress), returned to the cone
  pure subroutine start_state(self, f, stress, state)
    class(drucker_prager_t), intent(in) :: self
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

  !> Push b_e forward and return it to the cone
  pure subroutine advance_state(self, dt, l, df, f, state, dissipated)
    class(drucker_prager_t), intent(in) :: self
    real(wp), intent(in) :: dt, l(lanes, 9), df(lanes, 9), f(lanes, 9)
    real(wp), intent(inout) :: state(lanes, *)
    real(wp), intent(out) :: dissipated(lanes)
    real(wp) :: e(lanes, 6)
    call trial_strain(df, state(1, at_strain), e)
    call return_strain(self, e, state, dissipated)
  end subroutine advance_state

  !> Return the trial strain and store it
  pure subroutine return_strain(self, e, state, work)
    class(drucker_prager_t), intent(in) :: self
    real(wp), intent(in) :: e(lanes, 6) !! trial strain
    real(wp), intent(inout) :: state(lanes, *)
    real(wp), intent(out) :: work(lanes) !! plastic work: stress after the return on the plastic strain [J/m3]
    real(wp), parameter :: third = 1.0_wp/3.0_wp, root_third = sqrt(third)
    real(wp) :: mu, bulk, eta, eta_bar, strength, per_stiffness, per_mu, per_bulk, apex
    integer :: k
    mu = self%mu
    bulk = self%lambda + 2*self%mu/3
    eta = self%eta
    eta_bar = self%eta_bar
    strength = self%strength
    per_stiffness = 1.0_wp/(mu + bulk*eta*eta_bar)
    per_mu = 1.0_wp/mu
    per_bulk = 1.0_wp/bulk
    apex = strength/max(eta, tiny(1.0_wp)*max(1.0_wp, strength)) ! not used where eta = 0; the max keeps it finite
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: mean, d1, d2, d3, p, p_trial, root, root_trial, g, scale
        logical :: past_apex
        mean = third*(e(k, 1) + e(k, 2) + e(k, 3))
        d1 = e(k, 1) - mean
        d2 = e(k, 2) - mean
        d3 = e(k, 3) - mean
        p_trial = 3.0_wp*bulk*mean
        root_trial = mu*sqrt(2.0_wp*(d1*d1 + d2*d2 + d3*d3) &
          + 4.0_wp*(e(k, 4)*e(k, 4) + e(k, 5)*e(k, 5) + e(k, 6)*e(k, 6))) ! sqrt(J2)
        g = per_stiffness*max(0.0_wp, root_trial + eta*p_trial - strength)
        root = root_trial - mu*g
        past_apex = root < 0.0_wp ! only with friction: without it root = strength
        p = merge(apex, p_trial - bulk*eta_bar*g, past_apex)
        root = max(root, 0.0_wp)
        scale = merge(root/max(root_trial, tiny(1.0_wp)), 1.0_wp, g > 0.0_wp)
        mean = merge(third*per_bulk*p, mean, g > 0.0_wp)
        state(k, at_strain) = mean + scale*d1
        state(k, at_strain + 1) = mean + scale*d2
        state(k, at_strain + 2) = mean + scale*d3
        state(k, at_strain + 3) = scale*e(k, 4)
        state(k, at_strain + 4) = scale*e(k, 5)
        state(k, at_strain + 5) = scale*e(k, 6)
        work(k) = merge(per_bulk*p*(p_trial - p) + per_mu*root*(root_trial - root), 0.0_wp, g > 0.0_wp)
        state(k, at_plastic_strain) = state(k, at_plastic_strain) + root_third*per_mu*(root_trial - root)
      end block
    end do
  end subroutine return_strain

  !> The stress of the last return, and the bound of the wave speed. Where the flow is not associated a wave that loads can be
  !> faster than every elastic one (Loret, Prevost & Harireche 1990): the tangent is the elastic one less a (x) b/(mu + K eta etabar),
  !> a and b the normal components of C times flow direction and of C times gradient of f; -a.b <= |a - b|^2/4
  !> = (K (eta - etabar))^2/4.
  pure subroutine kirchhoff(self, f, state, tau, speed2)
    class(drucker_prager_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: tau(lanes, 6)
    real(wp), intent(out) :: speed2(lanes)
    real(wp) :: bulk, faster
    integer :: k
    call kirchhoff_of_strain(self%lambda, self%mu, state(1, at_strain), tau)
    call wave_bound(self%lambda, self%mu, self%density, tau, speed2)
    bulk = self%lambda + 2.0_wp*self%mu/3.0_wp
    faster = 0.25_wp*(bulk*(self%eta - self%eta_bar))**2/((self%mu + bulk*self%eta*self%eta_bar)*self%density)
    do k = 1, lanes
      if (state(k, at_plastic_strain) > 0.0_wp) speed2(k) = speed2(k) + faster
    end do
  end subroutine kirchhoff

  !> The elastic part
  pure subroutine stored_energy(self, f, state, energy)
    class(drucker_prager_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: energy(lanes)
    call elastic_energy(self%lambda, self%mu, state(1, at_strain), energy)
  end subroutine stored_energy

  !> The time integral of sqrt(2/3 dev Dp:dev Dp)
  pure subroutine equivalent_plastic_strain(self, state, ep)
    class(drucker_prager_t), intent(in) :: self
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: ep(lanes)
    ep = state(:, at_plastic_strain)
  end subroutine equivalent_plastic_strain

end module gimp_drucker_prager
