!> What every constitutive model offers.
!>
!> A call serves one chunk of `lanes` particles. Spare lanes hold F = I, L = 0 and the state that `start_state` makes of them:
!> a model must then give finite numbers. An inverted particle (J <= 0) must not trap either; the caller checks J.
!>
!> A history is scalars, then at most one symmetric tensor, which ends it. Its yz and zx components vanish in a plane, and xy
!> on a line: these last components are not stored there. Models always see the whole history.
module gimp_material
  use gimp_kinds, only: wp, lanes
  implicit none(type, external)
  private
  public :: material_t, most_states, load_history, keep_history

  integer, parameter :: most_states = 7 !! the longest history of the models

  !> A constitutive model
  type, abstract :: material_t
    character(len=32) :: name = "" !! the name the scene gives it
    character(len=32) :: model = "" !! the word of the model table
    real(wp) :: density = 0.0_wp !! reference density [kg/m3]
    real(wp) :: lambda = 0.0_wp !! first Lame constant [Pa]
    real(wp) :: mu = 0.0_wp !! shear modulus [Pa]
    integer :: states = 0 !! history components
  contains
    procedure(start_state_i), deferred :: start_state
    procedure(advance_state_i), deferred :: advance_state
    procedure(kirchhoff_i), deferred :: kirchhoff
    procedure(stored_energy_i), deferred :: stored_energy
    procedure :: stored_states
    procedure :: initial_speed
    procedure :: equivalent_plastic_strain
  end type material_t

  abstract interface
    !> The history at t = 0
    pure subroutine start_state_i(self, f, stress, state)
      import :: material_t, wp, lanes
      implicit none(type, external)
      class(material_t), intent(in) :: self
      real(wp), intent(in) :: f(lanes, 9) !! deformation gradient at t = 0
      real(wp), intent(in) :: stress(lanes, 6) !! Cauchy stress at t = 0 [Pa]; ignored where the stress follows from F
      real(wp), intent(inout) :: state(lanes, *) !! all `states` components are set
    end subroutine start_state_i

    !> Carry the history over one step
    pure subroutine advance_state_i(self, dt, l, df, f, state, dissipated)
      import :: material_t, wp, lanes
      implicit none(type, external)
      class(material_t), intent(in) :: self
      real(wp), intent(in) :: dt !! step [s]
      real(wp), intent(in) :: l(lanes, 9) !! velocity gradient [1/s]
      real(wp), intent(in) :: df(lanes, 9) !! increment that made the new F: F = dF F_old
      real(wp), intent(in) :: f(lanes, 9) !! new deformation gradient
      real(wp), intent(inout) :: state(lanes, *)
      real(wp), intent(out) :: dissipated(lanes) !! plastic work of this step per reference volume [J/m3]
    end subroutine advance_state_i

    !> The stress of the present state
    pure subroutine kirchhoff_i(self, f, state, tau, speed2)
      import :: material_t, wp, lanes
      implicit none(type, external)
      class(material_t), intent(in) :: self
      real(wp), intent(in) :: f(lanes, 9) !! deformation gradient
      real(wp), intent(in) :: state(lanes, *)
      real(wp), intent(out) :: tau(lanes, 6) !! Kirchhoff stress J sigma [Pa]
      real(wp), intent(out) :: speed2(lanes) !! upper bound of the squared speed of elastic waves, in space [m2/s2]
    end subroutine kirchhoff_i

    !> The elastic energy of the present state
    pure subroutine stored_energy_i(self, f, state, energy)
      import :: material_t, wp, lanes
      implicit none(type, external)
      class(material_t), intent(in) :: self
      real(wp), intent(in) :: f(lanes, 9) !! deformation gradient
      real(wp), intent(in) :: state(lanes, *)
      real(wp), intent(out) :: energy(lanes) !! per reference volume [J/m3]
    end subroutine stored_energy_i
  end interface

contains

  !> History components that a scene of dimension `dim` stores per particle
  pure integer function stored_states(self, dim)
    class(material_t), intent(in) :: self
    integer, intent(in) :: dim
    integer, parameter :: vanishing(3) = [3, 2, 0]
    stored_states = max(0, self%states - vanishing(dim))
  end function stored_states

  !> The whole history of a chunk from the components that are stored
  pure subroutine load_history(components, stored, history)
    integer, intent(in) :: components !! stored per particle
    real(wp), intent(in) :: stored(lanes, components)
    real(wp), intent(out) :: history(lanes, most_states) !! zero beyond them
    integer :: k, n
    do n = 1, components
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        history(k, n) = stored(k, n)
      end do
    end do
    do n = components + 1, most_states
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        history(k, n) = 0.0_wp
      end do
    end do
  end subroutine load_history

  !> Store the history of a chunk
  pure subroutine keep_history(components, history, stored)
    integer, intent(in) :: components !! stored per particle
    real(wp), intent(in) :: history(lanes, most_states)
    real(wp), intent(inout) :: stored(lanes, components)
    integer :: k, n
    do n = 1, components
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        stored(k, n) = history(k, n)
      end do
    end do
  end subroutine keep_history

  !> Speed of pressure waves in the unstressed material [m/s]
  pure real(wp) function initial_speed(self)
    class(material_t), intent(in) :: self
    initial_speed = sqrt((self%lambda + 2*self%mu)/self%density)
  end function initial_speed

  !> Accumulated plastic strain; zero for a model without plasticity
  pure subroutine equivalent_plastic_strain(self, state, ep)
    class(material_t), intent(in) :: self
    real(wp), intent(in) :: state(lanes, *)
    real(wp), intent(out) :: ep(lanes)
    ep = 0.0_wp
  end subroutine equivalent_plastic_strain

end module gimp_material
