!> What an exact solution is made of: its numbers, and the options from which they are set.
!>
!> The solutions, what they ask of a scene and where they come from are listed in gimp_verification.
module gimp_verification_types
  use gimp_kinds, only: dp, lanes
  implicit none(type, external)
  private
  public :: verification_t, verification_options_t, unset, is_set, set_at_rest, solution_words
  public :: vibrating_bar, axis_aligned, vortex, expanding_ring, self_weight_column, rigid_translation, rigid_rotation
  public :: law_neo_hookean, law_hencky, law_rate, law_other

  !> Marks an option that the author of the scene has not given
  real(dp), parameter :: unset = -huge(1.0_dp)

  !> The solutions by name; the constants below are positions in this list
  character(len=*), parameter :: solution_words = &
    "vibrating_bar axis_aligned vortex expanding_ring self_weight_column rigid_translation rigid_rotation"
  integer, parameter :: vibrating_bar = 1, axis_aligned = 2, vortex = 3, expanding_ring = 4, self_weight_column = 5, &
    rigid_translation = 6, rigid_rotation = 7

  !> The law that the material of the scene follows, as far as an exact solution depends on it
  integer, parameter :: law_other = 0, law_neo_hookean = 1, law_hencky = 2, law_rate = 3

  !> What the author of a scene may choose; what stays `unset` takes the default of the solution
  type :: verification_options_t
    character(len=32) :: solution = "" !! one of `solution_words`
    real(dp) :: amplitude = unset !! axis_aligned and expanding_ring [m], vortex [rad]
    real(dp) :: speed = unset !! vibrating_bar: greatest initial velocity v0 [m/s]
    real(dp) :: length = unset !! vibrating_bar, self_weight_column: undeformed length [m]
    real(dp) :: period = unset !! vortex: time in which it twists and returns, T [s]
    real(dp) :: gravity = unset !! self_weight_column: magnitude, pulling to lower coordinates [m/s2]
    real(dp) :: inner_radius = unset, outer_radius = unset !! vortex, expanding_ring [m]
    real(dp) :: velocity(3) = unset !! rigid_translation [m/s]
    real(dp) :: angular_velocity(3) = unset !! rigid_rotation [rad/s]; in 2D the third component is the spin
    real(dp) :: center(3) = unset !! origin of the solution's own coordinates [m]
    real(dp) :: phases(3) = unset !! axis_aligned [rad]
  end type verification_options_t

  !> An exact solution, ready to be evaluated: plain numbers only
  type :: verification_t
    integer :: solution = 0 !! 0: none
    integer :: dim = 0
    integer :: law = law_other
    real(dp) :: density = 0.0_dp !! rho0 [kg/m3]
    real(dp) :: young = 0.0_dp, poisson = 0.0_dp !! E [Pa], nu
    real(dp) :: lambda = 0.0_dp, mu = 0.0_dp !! Lame constants [Pa]
    real(dp) :: wave_speed = 0.0_dp !! c of the solution [m/s]: sqrt(E/rho0); bar: sqrt((lambda + 2 mu)/rho0)
    real(dp) :: omega = 0.0_dp !! angular frequency in time [rad/s]; 0 where nothing vibrates
    real(dp) :: wave_number = 0.0_dp !! in space [rad/m]
    real(dp) :: amplitude = 0.0_dp
    real(dp) :: speed = 0.0_dp, length = 0.0_dp, period = 0.0_dp, gravity = 0.0_dp
    real(dp) :: inner_radius = 0.0_dp, outer_radius = 0.0_dp
    real(dp) :: velocity(3) = 0.0_dp, angular_velocity(3) = 0.0_dp, center(3) = 0.0_dp, phases(3) = 0.0_dp
    real(dp) :: ring_c1 = 0.0_dp, ring_c2 = 0.0_dp, ring_c3 = 0.0_dp !! u_R/(A sin wt) = c1 R + c2 R^2 + c3 R^3
  end type verification_t

contains

  !> Has the author of the scene given this number?
  elemental logical function is_set(value)
    real(dp), intent(in) :: value
    is_set = value /= unset
  end function is_set

  !> A body that has not moved
  pure subroutine set_at_rest(u, vel, f)
    real(dp), intent(out) :: u(lanes, 3), vel(lanes, 3), f(lanes, 9)
    u = 0.0_dp
    vel = 0.0_dp
    f = 0.0_dp
    f(:, 1) = 1.0_dp
    f(:, 5) = 1.0_dp
    f(:, 9) = 1.0_dp
  end subroutine set_at_rest

end module gimp_verification_types
