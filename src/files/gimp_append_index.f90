!> What an append-only file holds, and its description in bytes: groups, headers, attributes and chunk indices.
!>
!> Part of `gimp_append_file`, which decides where the bytes go and when.
module gimp_append_index
  use gimp_common_kinds, only: i8
  use gimp_parcel, only: parcel_t, carry
  use gimp_hdf5_format, only: bytes_t, clear_bytes, element_bytes, undefined_address, put_object, put_group_messages, put_link, &
    put_chunked_messages, put_text_messages, put_attribute, node_width, put_tree_node, tree_node_bytes
  implicit none(type, external)
  private
  public :: object_t, attribute_t, a_group, a_table, a_text, row_bytes, put_leaf, describe, carry_object

  integer, parameter :: a_group = 1, a_table = 2, a_text = 3

  !> A named value of an object
  type :: attribute_t
    character(len=:), allocatable :: name, values !! values: their bytes
    integer :: stored = 0 !! element type
    integer :: length = 0 !! elements, 0 for a scalar
  end type attribute_t

  !> A group, a table or a text
  type :: object_t
    character(len=:), allocatable :: name
    integer :: parent = 0 !! number of the group it is in
    integer :: kind = 0 !! a_group, a_table or a_text
    integer :: attributes = 0
    type(attribute_t), allocatable :: attribute(:)
    integer :: stored = 0, rank = 0, components = 0 !! of a table
    integer(i8) :: chunk_rows = 0 !! rows stored together
    integer(i8) :: rows = 0 !! so far
    integer(i8) :: chunks = 0, leaves = 0
    integer(i8), allocatable :: chunk(:), leaf(:) !! addresses of all chunks and of the full index leaves
    integer(i8) :: address = 0 !! of a text
    integer :: length = 0 !! bytes of a text
  end type object_t

contains

  !> Bytes of one row of a table
  pure integer(i8) function row_bytes(o)
    type(object_t), intent(in) :: o
    row_bytes = int(o%components, i8)*element_bytes(o%stored)
  end function row_bytes

  !> A leaf with the chunks after the first `first`, at most as many as fit
  pure subroutine put_leaf(bytes, o, first, left)
    type(bytes_t), intent(inout) :: bytes
    type(object_t), intent(in) :: o
    integer(i8), intent(in) :: first, left
    integer(i8) :: rows(node_width), k
    integer :: n
    n = int(min(int(node_width, i8), o%chunks - first))
    rows = [(o%chunk_rows*(first + k), k=0, node_width - 1)]
    call put_tree_node(bytes, 0, o%rank, rows(:n), o%chunk_rows*(first + n), o%chunk_rows*row_bytes(o), &
      o%chunk(first + 1:first + n), left, undefined_address)
  end subroutine put_leaf

  !> Everything a reader needs, as bytes that will stand at address `base`
  subroutine describe(object, base, bytes, root)
    type(object_t), intent(in) :: object(:) !! all of them, the root group first
    integer(i8), intent(in) :: base
    type(bytes_t), intent(inout) :: bytes
    integer(i8), intent(out) :: root !! address of the root group
    type(bytes_t) :: messages
    integer(i8) :: address(size(object)), tree
    integer :: i, j
    call clear_bytes(bytes)
    address = undefined_address
    do i = size(object), 1, -1 ! what is in a group was made after it
      call clear_bytes(messages)
      associate (o => object(i))
        select case (o%kind)
        case (a_group)
          call put_group_messages(messages)
          do j = i + 1, size(object)
            if (object(j)%parent == i) call put_link(messages, object(j)%name, address(j))
          end do
        case (a_table)
          call put_tree(bytes, base, o, tree)
          call put_chunked_messages(messages, o%stored, o%rows, o%components, o%rank, o%chunk_rows, tree)
        case (a_text)
          call put_text_messages(messages, o%length, o%address)
        end select
        do j = 1, o%attributes
          call put_attribute(messages, o%attribute(j)%name, o%attribute(j)%stored, o%attribute(j)%length, &
            o%attribute(j)%values)
        end do
      end associate
      address(i) = base + bytes%n
      call put_object(bytes, messages)
    end do
    root = address(1)
  end subroutine describe

  !> The part of a table's index that changes: its last leaf and all above the leaves
  subroutine put_tree(bytes, base, o, root)
    type(bytes_t), intent(inout) :: bytes
    integer(i8), intent(in) :: base
    type(object_t), intent(in) :: o
    integer(i8), intent(out) :: root
    integer(i8), allocatable :: child(:), first_row(:), parent(:), parent_row(:)
    integer(i8) :: k, n, last, left, right, node_bytes, end_row
    integer :: level

    root = undefined_address
    if (o%chunks == 0) return
    node_bytes = tree_node_bytes(o%rank)
    child = o%leaf(:o%leaves)
    if (mod(o%chunks, int(node_width, i8)) /= 0) then
      left = undefined_address
      if (o%leaves > 0) left = o%leaf(o%leaves)
      child = [child, base + bytes%n]
      call put_leaf(bytes, o, o%leaves*node_width, left)
    end if
    first_row = [(o%chunk_rows*node_width*(k - 1), k=1, size(child, kind=i8))]
    level = 0
    do while (size(child) > 1)
      level = level + 1
      n = (size(child, kind=i8) + node_width - 1)/node_width
      allocate (parent(n), parent_row(n))
      do k = 1, n
        last = min(k*node_width, size(child, kind=i8))
        end_row = o%chunk_rows*o%chunks
        if (last < size(child)) end_row = first_row(last + 1)
        parent(k) = base + bytes%n
        parent_row(k) = first_row((k - 1)*node_width + 1)
        left = merge(undefined_address, parent(k) - node_bytes, k == 1)
        right = merge(undefined_address, parent(k) + node_bytes, k == n)
        call put_tree_node(bytes, level, o%rank, first_row((k - 1)*node_width + 1:last), end_row, &
          o%chunk_rows*row_bytes(o), child((k - 1)*node_width + 1:last), left, right)
      end do
      call move_alloc(parent, child)
      call move_alloc(parent_row, first_row)
    end do
    root = child(1)
  end subroutine put_tree

  !> Pack or unpack all that is known of an object
  pure subroutine carry_object(object, parcel)
    type(object_t), intent(inout) :: object
    type(parcel_t), intent(inout) :: parcel
    integer :: k
    call carry(parcel, object%name)
    call carry(parcel, object%parent)
    call carry(parcel, object%kind)
    call carry(parcel, object%stored)
    call carry(parcel, object%rank)
    call carry(parcel, object%components)
    call carry(parcel, object%chunk_rows)
    call carry(parcel, object%rows)
    call carry(parcel, object%chunks)
    call carry(parcel, object%leaves)
    call carry(parcel, object%chunk)
    call carry(parcel, object%leaf)
    call carry(parcel, object%address)
    call carry(parcel, object%length)
    call carry(parcel, object%attributes)
    if (parcel%reading .and. parcel%sound) allocate (object%attribute(max(4, object%attributes)))
    do k = 1, object%attributes
      if (.not. parcel%sound) return
      call carry(parcel, object%attribute(k)%name)
      call carry(parcel, object%attribute(k)%stored)
      call carry(parcel, object%attribute(k)%length)
      call carry(parcel, object%attribute(k)%values)
    end do
  end subroutine carry_object

end module gimp_append_index
