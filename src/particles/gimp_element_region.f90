!> Elements of a mesh as a region that bodies are filled from: each element is cut into pieces, a particle each.
!>
!> Pieces count in the order of the file (kind by kind, then by number), within an element with the last natural coordinate fastest,
!> so that the numbers of particles do not depend on how the program orders elements. Pieces lie between straight edges and sides
!> between their corners: those of quadratic elements follow curved sides as far as their corners do.
module gimp_element_region
  use gimp_kinds, only: wp, dp, i8
  use gimp_mesh, only: mesh_t, n_kinds, kind_dim, kind_nodes, triangle3, triangle6, tetrahedron4
  use gimp_elements, only: shape_values
  use gimp_search, only: locator_t, found_t, find_anywhere, found_outside
  use gimp_shapes, only: region_t
  use gimp_pieces, only: pieces_of, cut_piece, measure_piece
  implicit none(type, external)
  private
  public :: element_region_t, make_element_region, kind_is_simplex

  !> The pieces of an element of a kind
  type :: cut_t
    integer :: pieces = 0, corners = 0
    real(dp), allocatable :: share(:, :, :) !! (node, corner, piece) values of the shape functions at the corners
  end type cut_t

  type, extends(region_t) :: element_region_t
    type(mesh_t), pointer :: mesh => null()
    type(locator_t), pointer :: locator => null()
    real(dp) :: lower(3) = 0.0_dp !! corner that the mesh counts from [m]
    real(dp) :: spacing = 1.0_dp !! its unit of length [m]
    integer :: group = 0 !! of elements; 0: all
    type(cut_t) :: cut(n_kinds)
    integer, allocatable :: element(:) !! of the region, in the order of the file
    integer(i8), allocatable :: before(:) !! (elements + 1) pieces before those of an element
  contains
    procedure :: holds => region_holds
    procedure :: pieces => region_pieces
    procedure :: piece => region_piece
  end type element_region_t

contains

  !> Whether elements of a kind are triangles or tetrahedra
  elemental logical function kind_is_simplex(kind)
    integer, intent(in) :: kind
    kind_is_simplex = kind == triangle3 .or. kind == triangle6 .or. kind == tetrahedron4
  end function kind_is_simplex

  !> The elements of a group, or all
  subroutine make_element_region(mesh, locator, lower, spacing, group, parts, simplices, region, low, high)
    type(mesh_t), intent(in), target :: mesh
    type(locator_t), intent(in), target :: locator
    real(dp), intent(in) :: lower(3), spacing !! of the grid [m]
    integer, intent(in) :: group !! 0: all
    integer, intent(in) :: parts !! that an edge is cut into
    logical, intent(in) :: simplices !! pieces are to be triangles or tetrahedra
    type(element_region_t), intent(out) :: region !! holds while the mesh and the locator do
    real(dp), intent(out) :: low(3), high(3) !! box around it [m]
    integer :: k, kind
    region%mesh => mesh
    region%locator => locator
    region%lower = lower
    region%spacing = spacing
    region%group = group
    region%element = elements_in_file_order(mesh)
    if (group > 0) region%element = pack(region%element, mesh%element_group(region%element) == group)
    do kind = 1, n_kinds
      if (any(mesh%kind == kind)) call cut_kind(kind, parts, simplices, region%cut(kind))
    end do
    allocate (region%before(size(region%element) + 1))
    region%before(1) = 0
    low = lower
    high = lower
    do k = 1, size(region%element)
      associate (e => region%element(k))
        kind = mesh%kind(e)
        region%before(k + 1) = region%before(k) + region%cut(kind)%pieces
        call stretch(real(mesh%x(:, mesh%node(:kind_nodes(kind), e)), dp))
      end associate
    end do

  contains

    !> The box goes around these points as well
    subroutine stretch(x)
      real(dp), intent(in) :: x(:, :) !! [cells]
      integer :: d
      do d = 1, mesh%dim
        if (k == 1) low(d) = huge(1.0_dp)
        if (k == 1) high(d) = -huge(1.0_dp)
        low(d) = min(low(d), lower(d) + spacing*minval(x(d, :)))
        high(d) = max(high(d), lower(d) + spacing*maxval(x(d, :)))
      end do
    end subroutine stretch

  end subroutine make_element_region

  !> Elements kind by kind, each by its number in the file
  pure function elements_in_file_order(mesh) result(element)
    type(mesh_t), intent(in) :: mesh
    integer, allocatable :: element(:)
    integer :: first(n_kinds), kind, e
    first(1) = 0
    do kind = 2, n_kinds
      first(kind) = first(kind - 1) + count(mesh%kind == kind - 1)
    end do
    allocate (element(mesh%elements))
    do e = 1, mesh%elements
      element(first(mesh%kind(e)) + mesh%element_in_file(e)) = e
    end do
  end function elements_in_file_order

  !> Where the corners of the pieces of a kind are
  pure subroutine cut_kind(kind, parts, simplices, cut)
    integer, intent(in) :: kind, parts
    logical, intent(in) :: simplices
    type(cut_t), intent(inout) :: cut
    real(dp) :: xi(3, 8)
    real(wp) :: value(kind_nodes(kind)), at(kind_dim(kind))
    integer :: p, a, corners
    associate (d => kind_dim(kind), is_simplex => kind_is_simplex(kind))
      cut%pieces = pieces_of(d, is_simplex, parts, simplices)
      allocate (cut%share(kind_nodes(kind), 2**d, cut%pieces), source=0.0_dp)
      do p = 1, cut%pieces
        call cut_piece(d, is_simplex, parts, simplices, p, corners, xi)
        do a = 1, corners
          at = real(xi(:d, a), wp)
          call shape_values(kind, at, value)
          cut%share(:, a, p) = real(value, dp)
        end do
      end do
      cut%corners = corners
    end associate
  end subroutine cut_kind

  !> Does the point lie in one of the elements?
  pure logical function region_holds(self, x)
    class(element_region_t), intent(in) :: self
    real(dp), intent(in) :: x(:)
    type(found_t) :: found
    real(wp) :: at(size(x))
    at = real((x - self%lower(:size(x)))/self%spacing, wp)
    call find_anywhere(self%mesh, self%locator, at, found)
    region_holds = found%how /= found_outside
    if (region_holds .and. self%group > 0) region_holds = self%mesh%element_group(found%element) == self%group
  end function region_holds

  pure integer(i8) function region_pieces(self)
    class(element_region_t), intent(in) :: self
    region_pieces = self%before(size(self%before))
  end function region_pieces

  pure subroutine region_piece(self, number, corners, corner, content, centroid)
    class(element_region_t), intent(in) :: self
    integer(i8), intent(in) :: number
    integer, intent(out) :: corners
    real(dp), intent(out) :: corner(:, :), content, centroid(:)
    integer :: low, high, middle, a, k, p
    low = 1 ! the element of this piece is in [low, high)
    high = size(self%before)
    do while (high - low > 1)
      middle = (low + high)/2
      if (self%before(middle) < number) then
        low = middle
      else
        high = middle
      end if
    end do
    p = int(number - self%before(low))
    associate (mesh => self%mesh, e => self%element(low), d => self%mesh%dim)
      corners = self%cut(mesh%kind(e))%corners
      corner = 0.0_dp
      do a = 1, corners
        do k = 1, kind_nodes(mesh%kind(e))
          corner(:d, a) = corner(:d, a) + self%cut(mesh%kind(e))%share(k, a, p)*mesh%x(:, mesh%node(k, e))
        end do
      end do
      call measure_piece(corner(:, :corners), content, centroid)
      content = content*self%spacing**d
      centroid = self%lower(:d) + self%spacing*centroid
      do a = 1, corners
        corner(:d, a) = self%lower(:d) + self%spacing*corner(:d, a)
      end do
    end associate
  end subroutine region_piece

end module gimp_element_region
