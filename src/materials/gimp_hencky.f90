!> Hencky solid: W = mu e:e + lambda/2 tr(e)^2 with the logarithmic strain e = 1/2 ln b, tau = lambda tr(e) I + 2 mu e.
!>
!> Source: Hencky 1928; Anand 1979. The stress follows from F alone, b = F F^T: no history, no drift, exact elastic cycles.
module gimp_hencky
  use gimp_kinds, only: wp, lanes
  use gimp_material, only: material_t
  use gimp_material_options, only: material_options_t, set_elasticity
  use gimp_error, only: error_t
  use gimp_tensor_functions, only: strain_logarithm
  use gimp_log_strain, only: kirchhoff_of_strain, elastic_energy, wave_bound
  implicit none(type, external)
  private
  public :: hencky_t, make_hencky

  !> The model; needs density, lambda and mu
  type, extends(material_t) :: hencky_t
  contains
    procedure :: start_state
    procedure :: advance_state
    procedure :: kirchhoff
    procedure :: stored_energy
  end type hencky_t

contains

  !> From the options of a scene
  subroutine make_hencky(options, material, error)
    type(material_options_t), intent(in) :: options
    class(material_t), allocatable, intent(out) :: material
    type(error_t), allocatable, intent(out) :: error
    allocate (hencky_t :: material)
    call set_elasticity(options, material, error)
  end subroutine make_hencky

  !> No history: nothing to set, and an initial stress is ignored
  pure subroutine start_state(self, f, stress, state)
    class(hencky_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9), stress(lanes, 6)
    real(wp), intent(inout) :: state(lanes, *)
  end subroutine start_state

  !> No history: nothing to carry, nothing dissipated
  pure subroutine advance_state(self, dt, l, df, f, state, dissipated)
    class(hencky_t), intent(in) :: self
    real(wp), intent(in) :: dt, l(lanes, 9), df(lanes, 9), f(lanes, 9)
    real(wp), intent(inout) :: state(lanes, *)
    real(wp), intent(out) :: dissipated(lanes)
    dissipated = 0.0_wp
  end subroutine advance_state

  !> Kirchhoff stress and bound of the wave speed
  pure subroutine kirchhoff(self, f, state, tau, speed2)
    class(hencky_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: tau(lanes, 6)
    real(wp), intent(out) :: speed2(lanes)
    real(wp) :: e(lanes, 6)
    call strain_logarithm(f, e)
    call kirchhoff_of_strain(self%lambda, self%mu, e, tau)
    call wave_bound(self%lambda, self%mu, self%density, tau, speed2)
  end subroutine kirchhoff

  !> W = mu e:e + lambda/2 tr(e)^2
  pure subroutine stored_energy(self, f, state, energy)
    class(hencky_t), intent(in) :: self
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: energy(lanes)
    real(wp) :: e(lanes, 6)
    call strain_logarithm(f, e)
    call elastic_energy(self%lambda, self%mu, e, energy)
  end subroutine stored_energy

end module gimp_hencky
