!> Compressible neo-Hookean solid: W = mu/2 (tr b - 3) - mu ln J + lambda/2 ln^2 J, tau = mu (b - I) + lambda ln J I.
!>
!> Source: Simo & Pister 1984, as in Wriggers, Nonlinear Finite Element Methods (2008). The stress follows from F alone: no
!> history.
!>
!> Wave speed. With the spatial tangent lambda I (x) I + 2 (mu - lambda ln J) II and the geometric part, the acoustic tensor
!> for the direction n, times the current volume ratio, is
!>   rho0 Q = (lambda (1 - ln J) + mu) n (x) n + mu (n.b n) I,
!> so the fastest wave has rho0 c^2 = max(0, lambda (1 - ln J) + mu) + mu n.b n, at most that with the largest eigenvalue of
!> b, which Gershgorin's row sums bound.
module gimp_neo_hookean
  use gimp_kinds, only: wp, lanes
  use gimp_material, only: material_t
  use gimp_material_options, only: material_options_t, set_elasticity
  use gimp_error, only: error_t
  use gimp_tensor, only: determinant, natural_log
  implicit none(type, external)
  private
  public :: neo_hookean_t, make_neo_hookean

  !> The model; needs density, lambda and mu
  type, extends(material_t) :: neo_hookean_t
  contains
    procedure :: start_state
    procedure :: advance_state
    procedure :: kirchhoff
    procedure :: stored_energy
  end type neo_hookean_t

contains

  !> From the options of a scene
  subroutine make_neo_hookean(options, material, error)
    type(material_options_t), intent(in) :: options
    class(material_t), allocatable, intent(out) :: material
    type(error_t), allocatable, intent(out) :: error
    allocate (neo_hookean_t :: material)
    call set_elasticity(options, material, error)
  end subroutine make_neo_hookean

  !> No history: nothing to set, and an initial stress is ignored
  pure subroutine start_state(self, f, stress, state)
    class(neo_hookean_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9), stress(lanes, 6)
    real(wp), intent(inout) :: state(lanes, *)
  end subroutine start_state

  !> No history: nothing to carry, nothing dissipated
  pure subroutine advance_state(self, dt, l, df, f, state, dissipated)
    class(neo_hookean_t), intent(in) :: self
    real(wp), intent(in) :: dt, l(lanes, 9), df(lanes, 9), f(lanes, 9)
    real(wp), intent(inout) :: state(lanes, *)
    real(wp), intent(out) :: dissipated(lanes)
    dissipated = 0.0_wp
  end subroutine advance_state

  !> Kirchhoff stress and bound of the wave speed
  pure subroutine kirchhoff(self, f, state, tau, speed2)
    class(neo_hookean_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: tau(lanes, 6)
    real(wp), intent(out) :: speed2(lanes)
    real(wp) :: log_j(lanes), lambda, mu, per_density
    integer :: k
    lambda = self%lambda
    mu = self%mu
    per_density = 1.0_wp/self%density
    call determinant(f, log_j)
    call natural_log(log_j)
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: b1, b2, b3, b4, b5, b6, volumetric, largest
        b1 = f(k, 1)*f(k, 1) + f(k, 2)*f(k, 2) + f(k, 3)*f(k, 3)
        b2 = f(k, 4)*f(k, 4) + f(k, 5)*f(k, 5) + f(k, 6)*f(k, 6)
        b3 = f(k, 7)*f(k, 7) + f(k, 8)*f(k, 8) + f(k, 9)*f(k, 9)
        b4 = f(k, 1)*f(k, 4) + f(k, 2)*f(k, 5) + f(k, 3)*f(k, 6)
        b5 = f(k, 4)*f(k, 7) + f(k, 5)*f(k, 8) + f(k, 6)*f(k, 9)
        b6 = f(k, 7)*f(k, 1) + f(k, 8)*f(k, 2) + f(k, 9)*f(k, 3)
        volumetric = lambda*log_j(k)
        tau(k, 1) = mu*(b1 - 1.0_wp) + volumetric
        tau(k, 2) = mu*(b2 - 1.0_wp) + volumetric
        tau(k, 3) = mu*(b3 - 1.0_wp) + volumetric
        tau(k, 4) = mu*b4
        tau(k, 5) = mu*b5
        tau(k, 6) = mu*b6
        largest = max(b1 + abs(b4) + abs(b6), b2 + abs(b4) + abs(b5), b3 + abs(b5) + abs(b6))
        speed2(k) = per_density*(max(0.0_wp, lambda - volumetric + mu) + mu*largest)
      end block
    end do
  end subroutine kirchhoff

  !> W = mu/2 (tr b - 3) - mu ln J + lambda/2 ln^2 J
  pure subroutine stored_energy(self, f, state, energy)
    class(neo_hookean_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: energy(lanes)
    real(wp) :: log_j(lanes), lambda, mu
    integer :: k
    lambda = self%lambda
    mu = self%mu
    call determinant(f, log_j)
    call natural_log(log_j)
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      energy(k) = 0.5_wp*mu*(f(k, 1)**2 + f(k, 2)**2 + f(k, 3)**2 + f(k, 4)**2 + f(k, 5)**2 + f(k, 6)**2 &
        + f(k, 7)**2 + f(k, 8)**2 + f(k, 9)**2 - 3.0_wp) + log_j(k)*(0.5_wp*lambda*log_j(k) - mu)
    end do
  end subroutine stored_energy

end module gimp_neo_hookean
