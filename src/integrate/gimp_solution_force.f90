!> The body force that makes a manufactured solution exact, as the transfers ask for it
module gimp_solution_force
  use gimp_kinds, only: wp, dp, lanes
  use gimp_grid, only: grid_t
  use gimp_engine, only: body_force_t
  use gimp_verification, only: verification_t, body_force
  implicit none(type, external)
  private
  public :: solution_force_t

  !> Body force of an exact solution
  type, extends(body_force_t) :: solution_force_t
    type(verification_t) :: solution
    type(grid_t) :: grid
  contains
    procedure :: evaluate
  end type solution_force_t

contains

  !> Body force of the lanes of a chunk [m/s2]
  pure subroutine evaluate(self, t, x, b)
    class(solution_force_t), intent(in) :: self
    real(dp), intent(in) :: t !! [s]
    real(wp), intent(in) :: x(lanes, 3) !! reference position from the corner of the box [cells]
    real(wp), intent(out) :: b(lanes, 3)
    real(dp) :: place(lanes, 3), force(lanes, 3)
    integer :: k
    place = 0.0_dp
    do k = 1, self%grid%dim
      place(:, k) = self%grid%lower(k) + self%grid%spacing*x(:, k)
    end do
    call body_force(self%solution, t, place, force)
    b = real(force, wp)
  end subroutine evaluate

end module gimp_solution_force
