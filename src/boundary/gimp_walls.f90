!> Conditions on the sides of the box: what a node on a side, or beyond it, may do.
!>
!> Slip and symmetry hold the normal component; stick and velocity hold all. Where sides meet, slip is applied first, then
!> whatever holds more. Planes of symmetry and periodic sides also fold their ghosts (see gimp_images).
!>
!> On a mesh the nodes of its named sides have rules in the place of that (gimp_mesh_walls makes them).
module gimp_walls
  use gimp_kinds, only: wp, dp
  use gimp_grid, only: grid_t, nodes_per_block, low_side_node, high_side_node
  use gimp_time_table, only: time_table_t, factor_at
  implicit none(type, external)
  private
  public :: walls_t, wall_t, node_rule_t, side_free, side_stick, side_slip, side_symmetry, side_periodic, side_velocity
  public :: set_walls, walls_near, constrain, constrain_change, move_walls, side_of_word, condition_of_word, is_wall

  integer, parameter :: side_free = 0, side_stick = 1, side_slip = 2, side_symmetry = 3, side_periodic = 4, side_velocity = 5

  !> One side of the box, or one group of sides of a mesh
  type :: wall_t
    integer :: condition = side_free
    logical :: removes = .false. !! free side: material that leaves is taken out instead of ending the run
    real(dp) :: velocity(3) = 0.0_dp !! [m/s], condition velocity
    type(time_table_t) :: table
    real(wp) :: now(3) = 0.0_wp !! velocity at the present time [m/s]
  end type wall_t

  !> What a node on sides of a mesh may do
  type :: node_rule_t
    real(wp) :: held(3, 3) = 0.0_wp !! what is taken of a velocity: the projection on the directions that are held
    integer :: driven_by = 0 !! group of sides whose velocity the node has; 0: none
  end type node_rule_t

  !> All sides: (1, k) low, (2, k) high along axis k
  type :: walls_t
    type(wall_t) :: side(2, 3)
    ! of a mesh
    type(wall_t), allocatable :: group(:) !! (side group)
    integer, allocatable :: rule_of(:) !! (node) 0: none
    type(node_rule_t), allocatable :: rule(:)
  end type walls_t

contains

  !> Axis and end of a side from its word, e.g. x_low; axis 0 for an unknown word
  pure subroutine side_of_word(word, axis, end)
    character(len=*), intent(in) :: word
    integer, intent(out) :: axis, end
    axis = index("xyz", word(1:1))
    end = 1
    if (index(word, "_high") > 0) end = 2
    if (len_trim(word) < 5) axis = 0
  end subroutine side_of_word

  !> Number of a condition from its word, -1 for an unknown one
  pure integer function condition_of_word(word) result(condition)
    character(len=*), intent(in) :: word
    select case (word)
    case ("free"); condition = side_free
    case ("stick"); condition = side_stick
    case ("slip"); condition = side_slip
    case ("symmetry"); condition = side_symmetry
    case ("periodic"); condition = side_periodic
    case ("velocity"); condition = side_velocity
    case default; condition = -1
    end select
  end function condition_of_word

  !> Whether a side holds material back
  pure logical function is_wall(wall)
    type(wall_t), intent(in) :: wall
    is_wall = wall%condition /= side_free .and. wall%condition /= side_periodic
  end function is_wall

  !> Tell the grid which of its axes close on themselves and which sides are mirrors
  subroutine set_walls(walls, grid)
    type(walls_t), intent(in) :: walls
    type(grid_t), intent(inout) :: grid
    grid%periodic = walls%side(1, :)%condition == side_periodic
    grid%mirror_low = walls%side(1, :)%condition == side_symmetry
    grid%mirror_high = walls%side(2, :)%condition == side_symmetry
  end subroutine set_walls

  !> Velocity of every moving side at a time
  subroutine move_walls(walls, time)
    type(walls_t), intent(inout) :: walls
    real(dp), intent(in) :: time !! [s]
    integer :: k, e
    do k = 1, 3
      do e = 1, 2
        call move(walls%side(e, k), time)
      end do
    end do
    if (.not. allocated(walls%group)) return
    do k = 1, size(walls%group)
      call move(walls%group(k), time)
    end do
  end subroutine move_walls

  subroutine move(wall, time)
    type(wall_t), intent(inout) :: wall
    real(dp), intent(in) :: time
    if (wall%condition == side_velocity) wall%now = real(wall%velocity*factor_at(wall%table, time), wp)
  end subroutine move

  !> Whether some node of the block at `at`, or of that slot of a mesh, is held by a side
  pure logical function walls_near(walls, grid, at)
    type(walls_t), intent(in) :: walls
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(3)
    integer :: k
    walls_near = .false.
    if (grid%is_mesh) then
      if (.not. allocated(walls%rule_of)) return
      k = nodes_per_block*at(1)
      walls_near = any(walls%rule_of(k + 1:min(k + nodes_per_block, size(walls%rule_of))) > 0)
      return
    end if
    do k = 1, grid%dim
      if (is_wall(walls%side(1, k)) .and. at(k)*grid%edge(k) <= low_side_node(grid)) walls_near = .true.
      if (is_wall(walls%side(2, k)) .and. (at(k) + 1)*grid%edge(k) > high_side_node(grid, k)) walls_near = .true.
    end do
  end function walls_near

  !> Make a nodal velocity obey the sides
  pure subroutine constrain(walls, grid, node, v)
    type(walls_t), intent(in) :: walls
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: node(3) !! node coordinates; those on the sides are told by the grid, ghosts lie beyond
    real(wp), intent(inout) :: v(3) !! [m/s]
    integer :: k
    if (grid%is_mesh) then
      call obey_rule(walls, node(1), v)
      return
    end if
    do k = 1, grid%dim
      if (node(k) <= low_side_node(grid)) call hold_normal(walls%side(1, k), k, v)
      if (node(k) >= high_side_node(grid, k)) call hold_normal(walls%side(2, k), k, v)
    end do
    do k = 1, grid%dim
      if (node(k) <= low_side_node(grid)) call hold_all(walls%side(1, k), v)
      if (node(k) >= high_side_node(grid, k)) call hold_all(walls%side(2, k), v)
    end do
  end subroutine constrain

  !> The same for a node of a mesh
  pure subroutine obey_rule(walls, node, v)
    type(walls_t), intent(in) :: walls
    integer, intent(in) :: node !! number; beyond the last one are places of the last slot that no node has
    real(wp), intent(inout) :: v(3)
    integer :: rule
    if (.not. allocated(walls%rule_of)) return
    if (node > size(walls%rule_of)) return
    rule = walls%rule_of(node)
    if (rule == 0) return
    if (walls%rule(rule)%driven_by > 0) then
      v = walls%group(walls%rule(rule)%driven_by)%now
    else
      v = v - matmul(walls%rule(rule)%held, v) ! so that what is held along an axis is +0 as on a grid
    end if
  end subroutine obey_rule

  !> Make a change of a nodal velocity obey the sides: where the velocity is given, it does not change
  pure subroutine constrain_change(walls, grid, node, dv)
    type(walls_t), intent(in) :: walls
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: node(3)
    real(wp), intent(inout) :: dv(3) !! [m/s]
    real(wp) :: at_rest(3)
    at_rest = 0.0_wp
    call constrain(walls, grid, node, at_rest)
    call constrain(walls, grid, node, dv)
    dv = dv - at_rest
  end subroutine constrain_change

  pure subroutine hold_normal(wall, k, v)
    type(wall_t), intent(in) :: wall
    integer, intent(in) :: k
    real(wp), intent(inout) :: v(3)
    if (wall%condition == side_slip .or. wall%condition == side_symmetry) v(k) = 0.0_wp
  end subroutine hold_normal

  pure subroutine hold_all(wall, v)
    type(wall_t), intent(in) :: wall
    real(wp), intent(inout) :: v(3)
    if (wall%condition == side_stick) v = 0.0_wp
    if (wall%condition == side_velocity) v = wall%now
  end subroutine hold_all

end module gimp_walls
