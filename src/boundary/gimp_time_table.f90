!> A factor that depends on time: constant, a smooth ramp, or a piecewise-linear table
module gimp_time_table
  use gimp_kinds, only: wp
  implicit none(type, external)
  private
  public :: time_table_t, factor_at, smooth_ramp

  !> How a load or a wall's velocity is scaled in time
  type :: time_table_t
    real(wp) :: ramp_time = 0.0_wp !! [s]; 0: at once
    real(wp), allocatable :: times(:) !! [s] ascending; not allocated: no table
    real(wp), allocatable :: factors(:)
  end type time_table_t

contains

  !> The factor at a time; a table is constant before its first and after its last entry
  pure real(wp) function factor_at(table, time) result(factor)
    type(time_table_t), intent(in) :: table
    real(wp), intent(in) :: time !! [s]
    integer :: k, n
    factor = 1.0_wp
    if (table%ramp_time > 0.0_wp) factor = smooth_ramp(time/table%ramp_time)
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
  pure real(wp) function smooth_ramp(s)
    real(wp), intent(in) :: s
    real(wp) :: c
    c = min(1.0_wp, max(0.0_wp, s))
    smooth_ramp = c*c*c*(10.0_wp - c*(15.0_wp - 6.0_wp*c))
  end function smooth_ramp

end module gimp_time_table
