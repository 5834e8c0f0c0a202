!> A factor that depends on time: constant, a smooth ramp, or a piecewise-linear table
module gimp_time_table
  use gimp_kinds, only: dp
  implicit none(type, external)
  private
  public :: time_table_t, factor_at, smooth_ramp

  !> How a load or a wall's velocity is scaled in time
  type :: time_table_t
    real(dp) :: ramp_time = 0.0_dp !! [s]; 0: at once
    real(dp), allocatable :: times(:) !! [s] ascending; not allocated: no table
    real(dp), allocatable :: factors(:)
  end type time_table_t

contains

  !> The factor at a time; a table is constant before its first and after its last entry
  pure real(dp) function factor_at(table, time) result(factor)
    type(time_table_t), intent(in) :: table
    real(dp), intent(in) :: time !! [s]
    integer :: k, n
    factor = 1.0_dp
    if (table%ramp_time > 0.0_dp) factor = smooth_ramp(time/table%ramp_time)
    if (.not. allocated(table%times)) return
    n = size(table%times)
    if (n == 0) return
    if (time <= table%times(1)) then
      factor = table%factors(1)
    else if (time >= table%times(n)) then
      factor = table%factors(n)
    else
      do k = 2, n
        if (time <= table%times(k)) exit
      end do
      factor = table%factors(k - 1) + (table%factors(k) - table%factors(k - 1)) &
        *(time - table%times(k - 1))/(table%times(k) - table%times(k - 1))
    end if
  end function factor_at

  !> 10 s^3 - 15 s^4 + 6 s^5 between 0 and 1: no jump in value, speed or acceleration
  pure real(dp) function smooth_ramp(s)
    real(dp), intent(in) :: s
    real(dp) :: c
    c = min(1.0_dp, max(0.0_dp, s))
    smooth_ramp = c*c*c*(10.0_dp - c*(15.0_dp - 6.0_dp*c))
  end function smooth_ramp

end module gimp_time_table
