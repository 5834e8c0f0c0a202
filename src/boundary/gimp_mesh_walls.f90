!> Rules for the nodes on named sides of a mesh, from one condition per group of sides.
!>
!> Stick or velocity at any side of a node holds all of it; where such groups meet, the last of them does, as on the box, whose sides go
!> x_low, x_high, y_low, .. Else slip and symmetry hold normals. The normal at a node is the direction of the sum of int N n dA over its sides: for straight
!> edges and triangles the area-weighted mean, on curved sides that at the node. Sides of one group belong together if they
!> meet at no more than `smooth_angle`, or are joined by others that do; so do slip sides of two groups that meet at no more than
!> `joint_angle`. Sides that do not (corners, sharp edges) have their normals held beside each other: what is left is along the edge, or nothing.
!> A symmetry group must be plane, and its normal is held as it is. Middle nodes belong to their sides. Groups without a condition are free.
module gimp_mesh_walls
  use gimp_kinds, only: wp, dp
  use gimp_error, only: error_t, raise
  use gimp_mesh, only: mesh_t, element_label
  use gimp_walls, only: walls_t, wall_t, is_wall, side_stick, side_velocity, side_symmetry, side_periodic
  use gimp_side_shares, only: most_side_nodes, share_side
  implicit none(type, external)
  private
  public :: set_mesh_walls, smooth_angle, joint_angle

  real(dp), parameter :: degree = acos(-1.0_dp)/180.0_dp
  real(dp), parameter :: smooth_angle = 30.0_dp*degree !! within a group of sides
  real(dp), parameter :: joint_angle = 10.0_dp*degree !! of two groups; a normal so near to what is held already adds nothing
  real(dp), parameter :: flat = 1.0e-4_dp !! angle between sides of a plane: files may have few digits
  real(dp), parameter :: snap = 64.0_dp*epsilon(1.0_wp) !! smaller components of a normal are round-off, so that axes are exact

  !> Which held sides a node has
  type :: sides_t
    integer, allocatable :: first(:) !! (node + 1) where its entries begin
    integer, allocatable :: side(:) !! (entry) boundary side, ascending for each node
    real(dp), allocatable :: outward(:, :) !! (3, entry) int N n dA of the side and the node [cells^(dim - 1)]
  end type sides_t

contains

  !> Make the rules of all nodes
  subroutine set_mesh_walls(walls, mesh, condition, error)
    type(walls_t), intent(inout) :: walls
    type(mesh_t), intent(in) :: mesh !! connected
    type(wall_t), intent(in) :: condition(:) !! (side group)
    type(error_t), allocatable, intent(out) :: error
    type(sides_t) :: sides
    integer :: node, n
    call find_sides(mesh, condition, sides)
    call check_conditions(mesh, condition, sides, error)
    if (allocated(error)) return
    walls%group = condition
    if (allocated(walls%rule_of)) deallocate (walls%rule_of, walls%rule)
    allocate (walls%rule_of(mesh%nodes), source=0)
    allocate (walls%rule(count(sides%first(2:) > sides%first(:mesh%nodes))))
    n = 0
    do node = 1, mesh%nodes
      associate (first => sides%first(node), last => sides%first(node + 1) - 1)
        if (last < first) cycle
        n = n + 1
        walls%rule_of(node) = n
        call make_rule(mesh%dim, condition, mesh%side_group(sides%side(first:last)), sides%outward(:, first:last), &
                       walls%rule(n)%held, walls%rule(n)%driven_by)
      end associate
    end do
  end subroutine set_mesh_walls

  !> The sides with a condition that each node has
  subroutine find_sides(mesh, condition, sides)
    type(mesh_t), intent(in) :: mesh
    type(wall_t), intent(in) :: condition(:)
    type(sides_t), intent(out) :: sides
    real(dp) :: area(most_side_nodes), outward(3, most_side_nodes)
    integer :: pass, side, k, n, node(most_side_nodes), next(mesh%nodes + 1)
    next = 0
    do pass = 1, 2 ! count, then fill
      do side = 1, size(mesh%side_group)
        if (mesh%side_group(side) == 0) cycle
        if (.not. is_wall(condition(mesh%side_group(side)))) cycle
        call share_side(mesh, side, n, node, area, outward)
        do k = 1, n
          if (pass == 2) then
            sides%side(next(node(k))) = side
            sides%outward(:, next(node(k))) = outward(:, k)
          end if
          next(node(k)) = next(node(k)) + 1
        end do
      end do
      if (pass == 2) exit
      allocate (sides%first(mesh%nodes + 1))
      sides%first(1) = 1
      do k = 1, mesh%nodes
        sides%first(k + 1) = sides%first(k) + next(k)
      end do
      next = sides%first
      n = sides%first(mesh%nodes + 1) - 1
      allocate (sides%side(n), sides%outward(3, n))
    end do
  end subroutine find_sides

  !> Planes of symmetry are planes; nothing is periodic
  subroutine check_conditions(mesh, condition, sides, error)
    type(mesh_t), intent(in) :: mesh
    type(wall_t), intent(in) :: condition(:)
    type(sides_t), intent(in) :: sides
    type(error_t), allocatable, intent(out) :: error
    integer :: k, group, first(size(condition)) ! `first`: entry that shows the plane of a group
    do group = 1, size(condition)
      if (condition(group)%condition == side_periodic) then
        call raise(error, "side group '"//trim(mesh%side_group_name(group))//"': a mesh has no periodic sides; use a grid for them")
        return
      end if
    end do
    first = 0
    do k = 1, size(sides%side)
      group = mesh%side_group(sides%side(k))
      if (condition(group)%condition /= side_symmetry) cycle
      if (first(group) == 0) first(group) = k
      if (norm2(direction(sides%outward(:, k)) - direction(sides%outward(:, first(group)))) <= flat) cycle
      call raise(error, "side group '"//trim(mesh%side_group_name(group))//"': symmetry needs a plane, but sides of " &
                 //label(first(group))//" and "//label(k) &
                 //" face different ways; use 'slip', or a side group for each plane")
      return
    end do

  contains

    function label(entry)
      integer, intent(in) :: entry
      character(len=:), allocatable :: label
      label = element_label(mesh, mesh%side_element(sides%side(entry)))
    end function label

  end subroutine check_conditions

  !> The rule of a node from its sides
  pure subroutine make_rule(dim, condition, group, outward, held, driven_by)
    integer, intent(in) :: dim
    type(wall_t), intent(in) :: condition(:)
    integer, intent(in) :: group(:) !! (side)
    real(dp), intent(in) :: outward(:, :) !! (3, side)
    real(wp), intent(out) :: held(3, 3)
    integer, intent(out) :: driven_by
    real(dp) :: basis(3, 3), total(3)
    integer :: cluster(size(group)), holder, n, k, j, pass
    held = 0.0_wp
    driven_by = 0
    holder = maxval(group, mask=condition(group)%condition == side_stick .or. condition(group)%condition == side_velocity)
    if (holder > 0) then
      if (condition(holder)%condition == side_velocity) driven_by = holder
      do k = 1, 3
        held(k, k) = 1.0_wp
      end do
      return
    end if
    call join_sides(condition, group, outward, cluster)
    n = 0
    do pass = 1, 2 ! planes of symmetry first: they are held exactly
      do k = 1, size(group)
        if (cluster(k) /= k .or. (condition(group(k))%condition == side_symmetry .neqv. pass == 1)) cycle
        total = 0.0_dp
        do j = k, size(group)
          if (cluster(j) == k) total = total + outward(:, j)
        end do
        call add_normal(dim, direction(total), basis, n)
      end do
    end do
    do k = 1, 3
      if (n < dim) held(:, k) = real(matmul(basis(:, :n), basis(k, :n)), wp)
      if (n == dim .and. k <= dim) held(k, k) = 1.0_wp
    end do
  end subroutine make_rule

  !> Sides that share a normal have the same number, that of the first of them
  pure subroutine join_sides(condition, group, outward, cluster)
    type(wall_t), intent(in) :: condition(:)
    integer, intent(in) :: group(:)
    real(dp), intent(in) :: outward(:, :)
    integer, intent(out) :: cluster(:)
    real(dp) :: limit
    integer :: j, k, low, high
    cluster = [(k, k=1, size(group))]
    do k = 2, size(group)
      do j = 1, k - 1
        limit = merge(smooth_angle, joint_angle, group(j) == group(k))
        if (group(j) /= group(k) .and. any(condition(group([j, k]))%condition == side_symmetry)) cycle
        if (dot_product(direction(outward(:, j)), direction(outward(:, k))) < cos(limit + flat)) cycle
        low = min(cluster(j), cluster(k))
        high = max(cluster(j), cluster(k))
        where (cluster == high) cluster = low
      end do
    end do
  end subroutine join_sides

  !> One more direction that is held, unless those there hold it already
  pure subroutine add_normal(dim, normal, basis, n)
    integer, intent(in) :: dim
    real(dp), intent(in) :: normal(3)
    real(dp), intent(inout) :: basis(3, 3) !! orthonormal
    integer, intent(inout) :: n
    real(dp) :: rest(3)
    integer :: k
    if (n == dim) return
    rest = normal
    do k = 1, n
      rest = rest - dot_product(basis(:, k), rest)*basis(:, k)
    end do
    if (n > 0 .and. norm2(rest) < sin(joint_angle)) return
    n = n + 1
    basis(:, n) = direction(rest)
  end subroutine add_normal

  !> Unit vector without round-off along axes
  pure function direction(vector) result(unit)
    real(dp), intent(in) :: vector(3)
    real(dp) :: unit(3)
    unit = vector/norm2(vector)
    where (abs(unit) < snap) unit = 0.0_dp
    unit = unit/norm2(unit)
  end function direction

end module gimp_mesh_walls
