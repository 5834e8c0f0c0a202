module gimp_element_lanes
  use gimp_kinds, only: wp, lanes
  use gimp_elements, only: natural_coordinates, shape_values, shape_slopes, beyond
  implicit none(type, external)
  private
  public :: lane_weights, lane_weights_slopes
contains
  pure subroutine lane_weights(kind, dim, nodes, xe, x, w, over)
    integer, intent(in) :: kind, dim, nodes
    real(wp), intent(in) :: xe(lanes, dim, nodes), x(lanes, dim)
    real(wp), intent(out) :: w(lanes, nodes), over(lanes)
    real(wp) :: g(lanes, dim, nodes)
    call lane_weights_slopes(kind, dim, nodes, xe, x, w, g, over)
  end subroutine
  pure subroutine lane_weights_slopes(kind, dim, nodes, xe, x, w, g, over)
    integer, intent(in) :: kind, dim, nodes
    real(wp), intent(in) :: xe(lanes, dim, nodes), x(lanes, dim)
    real(wp), intent(out) :: w(lanes, nodes), g(lanes, dim, nodes), over(lanes)
    real(wp) :: xi(dim), n(nodes), dn(dim, nodes), j(dim, dim), a(dim, dim), det
    integer :: l
    logical :: ok
    do l = 1, lanes
      call natural_coordinates(kind, xe(l, :, :), x(l, :), xi, ok)
      over(l) = beyond(kind, xi)
      if (.not. ok) over(l) = huge(1.0_wp)
      call shape_values(kind, xi, n)
      call shape_slopes(kind, xi, dn)
      j = matmul(xe(l, :, :), transpose(dn))
      if (dim == 1) then
        a = 1.0_wp/j
      else if (dim == 2) then
        det = j(1, 1)*j(2, 2) - j(1, 2)*j(2, 1)
        a(1, :) = [j(2, 2), -j(1, 2)]/det
        a(2, :) = [-j(2, 1), j(1, 1)]/det
      else
        a = 0.0_wp
        det = j(1,1)*(j(2,2)*j(3,3)-j(2,3)*j(3,2)) - j(1,2)*(j(2,1)*j(3,3)-j(2,3)*j(3,1)) + j(1,3)*(j(2,1)*j(3,2)-j(2,2)*j(3,1))
        a(1,:) = [j(2,2)*j(3,3)-j(2,3)*j(3,2), j(1,3)*j(3,2)-j(1,2)*j(3,3), j(1,2)*j(2,3)-j(1,3)*j(2,2)]/det
        a(2,:) = [j(2,3)*j(3,1)-j(2,1)*j(3,3), j(1,1)*j(3,3)-j(1,3)*j(3,1), j(1,3)*j(2,1)-j(1,1)*j(2,3)]/det
        a(3,:) = [j(2,1)*j(3,2)-j(2,2)*j(3,1), j(1,2)*j(3,1)-j(1,1)*j(3,2), j(1,1)*j(2,2)-j(1,2)*j(2,1)]/det
      end if
      w(l, :) = n
      g(l, :, :) = matmul(transpose(a), dn)
    end do
  end subroutine
end module
