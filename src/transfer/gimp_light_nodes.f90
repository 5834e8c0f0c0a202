!> Light nodes hand the internal force they cannot carry to the other nodes of the particle it comes from.
!>
!> A node of mass m_i can carry the share c_i = min(1, m_i/m_c). Of the force f_ip of a particle on it, c_i f_ip stays; the rest goes
!> to the other nodes j of the particle in proportion S_jp c_j (in the spirit of the distribution coefficients of Ma, Giguere, Jayaraman
!> & Zhang 2010). The sum of forces is unchanged, accelerations are bounded by those of a node of mass m_c, and the velocity gradient
!> is left alone, so that linear fields stay exact; the work of the force is then no longer the exact counterpart of the stress power.
module gimp_light_nodes
  use gimp_kinds, only: wp, lanes
  use gimp_grid, only: grid_t, nf => fields_per_node
  use gimp_basis, only: weight_list_t
  use gimp_list_kernel, only: wide_place
  implicit none(type, external)
  private
  public :: hand_on, wide_lightness, give_wide, light_field

  integer, parameter :: light_field = nf !! of the grid, between the velocities of nodes and their forces: 1 - c_i
  real(wp), parameter :: hardly = 1.0e-12_wp !! a force stays where the other nodes together can carry less than this share

contains

  !> Forces on the nodes of a weight list after the light ones have handed on theirs
  pure subroutine hand_on(dim, list, light, slope, f, moved)
    integer, intent(in) :: dim
    type(weight_list_t), intent(in) :: list
    real(wp), intent(in) :: light(:) !! (nodes of the list) 1 - c_i
    real(wp), intent(in) :: slope(3, dim) !! f_i = slope . G_i
    real(wp), intent(out) :: f(:, :) !! (3, nodes of the list) [N]
    real(wp), intent(out) :: moved !! sum of the norms of what was handed on [N]
    real(wp) :: able(list%n), given(3, list%n), common(3), total, rest
    integer :: i, k
    able = list%s(:list%n)*(1.0_wp - light(:list%n))
    total = sum(able)
    given = 0.0_wp
    moved = 0.0_wp
    do i = 1, list%n
      f(:, i) = 0.0_wp
      do k = 1, dim
        f(:, i) = f(:, i) + list%g(k, i)*slope(:, k)
      end do
      rest = total - able(i)
      if (light(i) <= 0.0_wp .or. rest <= hardly*total) cycle
      given(:, i) = light(i)/rest*f(:, i)
      moved = moved + light(i)*norm2(f(:, i))
      f(:, i) = (1.0_wp - light(i))*f(:, i)
    end do
    if (moved <= 0.0_wp) return
    common = sum(given, dim=2)
    do i = 1, list%n
      f(:, i) = f(:, i) + able(i)*(common - given(:, i))
    end do
  end subroutine hand_on

  !> 1 - c_i of the nodes of a list, from the nodes around a block
  pure subroutine wide_lightness(grid, list, wide, light)
    type(grid_t), intent(in) :: grid
    type(weight_list_t), intent(in) :: list
    real(wp), intent(in) :: wide(nf, *)
    real(wp), intent(inout) :: light(:) !! (nodes of the list)
    integer :: i
    do i = 1, list%n
      light(i) = wide(light_field, wide_place(grid, list%node(:, i)))
    end do
  end subroutine wide_lightness

  !> Internal forces f of a list, and by its weights what is given to values, to the nodes around a block
  pure subroutine give_wide(grid, list, value, f, wide)
    type(grid_t), intent(in) :: grid
    type(weight_list_t), intent(in) :: list
    real(wp), intent(in) :: value(nf), f(:, :) !! (3, nodes of the list)
    real(wp), intent(inout) :: wide(nf, *)
    integer :: i, place
    do i = 1, list%n
      place = wide_place(grid, list%node(:, i))
      wide(:, place) = wide(:, place) + list%s(i)*value
      wide(5:7, place) = wide(5:7, place) + f(:, i)
    end do
  end subroutine give_wide

end module gimp_light_nodes
