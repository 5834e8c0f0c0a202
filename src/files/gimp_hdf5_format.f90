!> The few structures of an HDF5 file that `gimp_append_file` writes, as bytes.
!>
!> Source: "HDF5 File Format Specification, Version 3.0" (The HDF Group); section numbers below are its own. Only what is needed
!> is here: superblock version 2, object headers version 2, compact groups, contiguous and chunked layout, version 1 B-trees.
!> Any HDF5 library from 1.8 on reads such files. Numbers are little-endian.
module gimp_hdf5_format
  use gimp_common_kinds, only: i8
  implicit none(type, external)
  private
  public :: bytes_t, clear_bytes, put_bytes, put_integer, lookup3
  public :: stored_real32, stored_real64, stored_int64, stored_text, element_bytes, undefined_address, superblock_bytes
  public :: superblock, put_object, put_group_messages, put_link, put_chunked_messages, put_text_messages, put_attribute
  public :: node_width, put_tree_node, tree_node_bytes

  integer, parameter :: stored_real32 = 1, stored_real64 = 2, stored_int64 = 3, stored_text = 4 !! element types
  integer, parameter :: element_bytes(3) = [4, 8, 8] !! of the numbers
  integer(i8), parameter :: undefined_address = -1_i8 !! all bits set
  integer, parameter :: superblock_bytes = 48
  integer, parameter :: node_width = 64 !! children of a chunk B-tree node: the format's default of 2*32

  !> Bytes that grow at the end
  type :: bytes_t
    integer :: n = 0
    character(len=:), allocatable :: data !! the first n count
  end type bytes_t

contains

  pure subroutine clear_bytes(bytes)
    type(bytes_t), intent(inout) :: bytes
    bytes%n = 0
    if (.not. allocated(bytes%data)) allocate (character(len=1024) :: bytes%data)
  end subroutine clear_bytes

  pure subroutine put_bytes(bytes, text)
    type(bytes_t), intent(inout) :: bytes
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: wider
    if (.not. allocated(bytes%data)) call clear_bytes(bytes)
    if (bytes%n + len(text) > len(bytes%data)) then
      allocate (character(len=2*(bytes%n + len(text))) :: wider)
      wider(:bytes%n) = bytes%data(:bytes%n)
      call move_alloc(wider, bytes%data)
    end if
    bytes%data(bytes%n + 1:bytes%n + len(text)) = text
    bytes%n = bytes%n + len(text)
  end subroutine put_bytes

  !> The lowest `width` bytes of a number, least significant first
  pure subroutine put_integer(bytes, value, width)
    type(bytes_t), intent(inout) :: bytes
    integer(i8), intent(in) :: value
    integer, intent(in) :: width
    character(len=8) :: buffer
    integer :: k
    do k = 1, width
      buffer(k:k) = char(int(ibits(value, 8*(k - 1), 8)))
    end do
    call put_bytes(bytes, buffer(:width))
  end subroutine put_integer

  pure subroutine put_numbers(bytes, values, width)
    type(bytes_t), intent(inout) :: bytes
    integer, intent(in) :: values(:)
    integer, intent(in) :: width
    integer :: k
    do k = 1, size(values)
      call put_integer(bytes, int(values(k), i8), width)
    end do
  end subroutine put_numbers

  !> Superblock version 2 (II.B); the one place that says where the rest is, short enough to be written in one piece
  pure function superblock(root, end_of_file) result(text)
    integer(i8), intent(in) :: root !! address of the root group's header
    integer(i8), intent(in) :: end_of_file !! bytes of the file that count
    character(len=superblock_bytes) :: text
    type(bytes_t) :: b
    call put_bytes(b, char(137)//"HDF"//char(13)//char(10)//char(26)//char(10))
    call put_numbers(b, [2, 8, 8, 0], 1) ! version, bytes of an offset, bytes of a length, no flags
    call put_integer(b, 0_i8, 8) ! base address
    call put_integer(b, undefined_address, 8) ! no extension
    call put_integer(b, end_of_file, 8)
    call put_integer(b, root, 8)
    call put_integer(b, lookup3(b%data(:b%n)), 4)
    text = b%data(:b%n)
  end function superblock

  !> Object header version 2 (IV.A.1.b) around messages
  pure subroutine put_object(bytes, messages)
    type(bytes_t), intent(inout) :: bytes
    type(bytes_t), intent(in) :: messages
    integer :: first
    first = bytes%n + 1
    call put_bytes(bytes, "OHDR")
    call put_numbers(bytes, [2, 2], 1) ! version; flags: the size that follows takes four bytes
    call put_integer(bytes, int(messages%n, i8), 4)
    call put_bytes(bytes, messages%data(:messages%n))
    call put_integer(bytes, lookup3(bytes%data(first:bytes%n)), 4)
  end subroutine put_object

  !> The prefix of a header message: type, size, no flags
  pure subroutine put_message_prefix(messages, kind, size)
    type(bytes_t), intent(inout) :: messages
    integer, intent(in) :: kind, size
    call put_integer(messages, int(kind, i8), 1)
    call put_integer(messages, int(size, i8), 2)
    call put_integer(messages, 0_i8, 1)
  end subroutine put_message_prefix

  !> What every group carries: link info (IV.A.2.c) without an index, and group info (IV.A.2.k)
  pure subroutine put_group_messages(messages)
    type(bytes_t), intent(inout) :: messages
    call put_message_prefix(messages, 2, 18)
    call put_numbers(messages, [0, 0], 1)
    call put_integer(messages, undefined_address, 8)
    call put_integer(messages, undefined_address, 8)
    call put_message_prefix(messages, 10, 2)
    call put_numbers(messages, [0, 0], 1)
  end subroutine put_group_messages

  !> A hard link (IV.A.2.g) to an object; names are shorter than 256 bytes
  pure subroutine put_link(messages, name, address)
    type(bytes_t), intent(inout) :: messages
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: address
    call put_message_prefix(messages, 6, 11 + len(name))
    call put_numbers(messages, [1, 0, len(name)], 1)
    call put_bytes(messages, name)
    call put_integer(messages, address, 8)
  end subroutine put_link

  !> A dataset of rank 1 or 2 that grows along its first dimension, in chunks that hold all components
  pure subroutine put_chunked_messages(messages, stored, rows, components, rank, chunk_rows, tree)
    type(bytes_t), intent(inout) :: messages
    integer, intent(in) :: stored !! element type
    integer(i8), intent(in) :: rows !! present length
    integer, intent(in) :: components, rank
    integer(i8), intent(in) :: chunk_rows
    integer(i8), intent(in) :: tree !! address of the B-tree's root, undefined without chunks
    ! dataspace (IV.A.2.b) version 2, with the largest dimensions
    call put_message_prefix(messages, 1, 4 + 16*rank)
    call put_numbers(messages, [2, rank, 1, 1], 1)
    call put_integer(messages, rows, 8)
    if (rank == 2) call put_integer(messages, int(components, i8), 8)
    call put_integer(messages, -1_i8, 8) ! unlimited
    if (rank == 2) call put_integer(messages, int(components, i8), 8)
    call put_message_prefix(messages, 3, len(datatype(stored, 0, .true.)))
    call put_bytes(messages, datatype(stored, 0, .true.))
    call put_fill_message(messages)
    ! layout (IV.A.2.i) version 3, class 2: the last dimension is the size of an element
    call put_message_prefix(messages, 8, 3 + 8 + 4*(rank + 1))
    call put_numbers(messages, [3, 2, rank + 1], 1)
    call put_integer(messages, tree, 8)
    call put_integer(messages, chunk_rows, 4)
    if (rank == 2) call put_numbers(messages, [components], 4)
    call put_numbers(messages, [element_bytes(stored)], 4)
  end subroutine put_chunked_messages

  !> A scalar UTF-8 string of fixed length, stored in one piece elsewhere
  pure subroutine put_text_messages(messages, length, address)
    type(bytes_t), intent(inout) :: messages
    integer, intent(in) :: length !! bytes, at least 1
    integer(i8), intent(in) :: address
    call put_message_prefix(messages, 1, 4)
    call put_numbers(messages, [2, 0, 0, 0], 1)
    call put_message_prefix(messages, 3, 8)
    call put_bytes(messages, datatype(stored_text, length, .false.))
    call put_fill_message(messages)
    call put_message_prefix(messages, 8, 18)
    call put_numbers(messages, [3, 1], 1)
    call put_integer(messages, address, 8)
    call put_integer(messages, int(length, i8), 8)
  end subroutine put_text_messages

  !> Fill value (IV.A.2.f) version 3: space when needed, default value
  pure subroutine put_fill_message(messages)
    type(bytes_t), intent(inout) :: messages
    call put_message_prefix(messages, 5, 2)
    call put_numbers(messages, [3, 11], 1)
  end subroutine put_fill_message

  !> An attribute (IV.A.2.m) version 3; `values` are its bytes
  pure subroutine put_attribute(messages, name, stored, length, values)
    type(bytes_t), intent(inout) :: messages
    character(len=*), intent(in) :: name, values
    integer, intent(in) :: stored !! element type
    integer, intent(in) :: length !! 0: a scalar; else elements of a vector. A text is a scalar of at least one byte
    character(len=:), allocatable :: type
    integer :: space
    type = datatype(stored, len(values), is_ascii(values))
    space = 4
    if (length > 0) space = 12
    call put_message_prefix(messages, 12, 9 + len(name) + 1 + len(type) + space + len(values))
    call put_numbers(messages, [3, 0], 1)
    call put_numbers(messages, [len(name) + 1, len(type), space], 2)
    call put_integer(messages, 1_i8, 1) ! the name is UTF-8
    call put_bytes(messages, name//char(0))
    call put_bytes(messages, type)
    if (length > 0) then
      call put_numbers(messages, [2, 1, 0, 1], 1)
      call put_integer(messages, int(length, i8), 8)
    else
      call put_numbers(messages, [2, 0, 0, 0], 1)
    end if
    call put_bytes(messages, values)
  end subroutine put_attribute

  pure logical function is_ascii(text)
    character(len=*), intent(in) :: text
    integer :: k
    is_ascii = .true.
    do k = 1, len(text)
      is_ascii = is_ascii .and. ichar(text(k:k)) < 128
    end do
  end function is_ascii

  !> Datatype message (IV.A.2.d); `length` and `ascii` matter for text only
  pure function datatype(stored, length, ascii) result(text)
    integer, intent(in) :: stored, length
    logical, intent(in) :: ascii !! else UTF-8; readers of VTKHDF want its attribute `Type` in ASCII
    character(len=:), allocatable :: text
    type(bytes_t) :: b
    select case (stored)
    case (stored_real32) ! IEEE: sign bit 31, exponent 8 bits from 23 on, bias 127
      call put_numbers(b, [17, 32, 31, 0], 1)
      call put_numbers(b, [4], 4)
      call put_numbers(b, [0, 32], 2)
      call put_numbers(b, [23, 8, 0, 23], 1)
      call put_numbers(b, [127], 4)
    case (stored_real64)
      call put_numbers(b, [17, 32, 63, 0], 1)
      call put_numbers(b, [8], 4)
      call put_numbers(b, [0, 64], 2)
      call put_numbers(b, [52, 11, 0, 52], 1)
      call put_numbers(b, [1023], 4)
    case (stored_int64) ! signed
      call put_numbers(b, [16, 8, 0, 0], 1)
      call put_numbers(b, [8], 4)
      call put_numbers(b, [0, 64], 2)
    case default
      call put_numbers(b, [19, merge(1, 17, ascii), 0, 0], 1) ! padded with zero bytes
      call put_numbers(b, [length], 4)
    end select
    text = b%data(:b%n)
  end function datatype

  !> Bytes of a chunk B-tree node in the file: always the full width, whatever it holds
  pure integer function tree_node_bytes(rank)
    integer, intent(in) :: rank !! of the dataset
    tree_node_bytes = 24 + 8*node_width + (8 + 8*(rank + 1))*(node_width + 1)
  end function tree_node_bytes

  !> A node of a version 1 B-tree of chunks (III.A.1)
  pure subroutine put_tree_node(bytes, level, rank, first_rows, end_row, chunk_bytes, children, left, right)
    type(bytes_t), intent(inout) :: bytes
    integer, intent(in) :: level !! 0 for a leaf, whose children are chunks
    integer, intent(in) :: rank
    integer(i8), intent(in) :: first_rows(:) !! first row below each child
    integer(i8), intent(in) :: end_row !! first row after the last child
    integer(i8), intent(in) :: chunk_bytes
    integer(i8), intent(in) :: children(:) !! addresses, at most `node_width`
    integer(i8), intent(in) :: left, right !! neighbours on the same level
    integer :: first, k
    first = bytes%n
    call put_bytes(bytes, "TREE")
    call put_numbers(bytes, [1, level], 1)
    call put_integer(bytes, size(children, kind=i8), 2)
    call put_integer(bytes, left, 8)
    call put_integer(bytes, right, 8)
    do k = 1, size(children)
      call put_key(bytes, rank, first_rows(k), chunk_bytes)
      call put_integer(bytes, children(k), 8)
    end do
    call put_key(bytes, rank, end_row, 0_i8)
    call put_bytes(bytes, repeat(char(0), tree_node_bytes(rank) - (bytes%n - first)))
  end subroutine put_tree_node

  !> What stands before and after a child: where its chunk begins; other dimensions and the element are held whole
  pure subroutine put_key(bytes, rank, row, stored_bytes)
    type(bytes_t), intent(inout) :: bytes
    integer, intent(in) :: rank
    integer(i8), intent(in) :: row, stored_bytes
    call put_integer(bytes, stored_bytes, 4)
    call put_integer(bytes, 0_i8, 4) ! no filter skipped
    call put_integer(bytes, row, 8)
    call put_bytes(bytes, repeat(char(0), 8*rank))
  end subroutine put_key

  !> The checksum of the format: `lookup3` (Jenkins 2006, "hashlittle" with initial value 0), as a number in [0, 2^32)
  pure integer(i8) function lookup3(text) result(hash)
    character(len=*), intent(in) :: text
    integer(i8) :: a, b, c
    integer :: at, rest
    a = low(int(z"DEADBEEF", i8) + len(text))
    b = a
    c = a
    at = 1
    rest = len(text)
    do while (rest > 12)
      a = low(a + word(at, 4))
      b = low(b + word(at + 4, 4))
      c = low(c + word(at + 8, 4))
      a = ieor(low(a - c), turned(c, 4)); c = low(c + b)
      b = ieor(low(b - a), turned(a, 6)); a = low(a + c)
      c = ieor(low(c - b), turned(b, 8)); b = low(b + a)
      a = ieor(low(a - c), turned(c, 16)); c = low(c + b)
      b = ieor(low(b - a), turned(a, 19)); a = low(a + c)
      c = ieor(low(c - b), turned(b, 4)); b = low(b + a)
      at = at + 12
      rest = rest - 12
    end do
    hash = c
    if (rest == 0) return
    a = low(a + word(at, min(4, rest)))
    b = low(b + word(at + 4, min(4, rest - 4)))
    c = low(c + word(at + 8, rest - 8))
    c = low(ieor(c, b) - turned(b, 14))
    a = low(ieor(a, c) - turned(c, 11))
    b = low(ieor(b, a) - turned(a, 25))
    c = low(ieor(c, b) - turned(b, 16))
    a = low(ieor(a, c) - turned(c, 4))
    b = low(ieor(b, a) - turned(a, 14))
    hash = low(ieor(c, b) - turned(b, 24))
  contains
    pure integer(i8) function low(value) ! modulo 2^32
      integer(i8), intent(in) :: value
      low = ibits(value, 0, 32)
    end function low

    pure integer(i8) function turned(value, bits) ! rotated left within 32 bits
      integer(i8), intent(in) :: value
      integer, intent(in) :: bits
      turned = ior(ibits(shiftl(value, bits), 0, 32), shiftr(value, 32 - bits))
    end function turned

    pure integer(i8) function word(first, width) ! up to four bytes, none for a width below 1
      integer, intent(in) :: first, width
      integer :: k
      word = 0
      do k = 1, width
        word = ior(word, shiftl(int(ichar(text(first + k - 1:first + k - 1)), i8), 8*(k - 1)))
      end do
    end function word
  end function lookup3

end module gimp_hdf5_format
