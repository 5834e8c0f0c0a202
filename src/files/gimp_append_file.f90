!> An HDF5 file that only grows, and whose last commit is whole whatever happens to the program.
!>
!> Why not the HDF5 library: it changes its index in place, many writes long. A writer of growing datasets that flushed after
!> every frame was killed (signal 9) at random moments; in 29 of 60 files committed frames could not be read any more.
!> HDF5's own remedy (single writer, multiple readers) leaves a mark in a killed file that makes ordinary readers refuse it.
!>
!> How it works: rows go to room that no committed structure points to (new chunks, or the unused tail of the last chunk). A
!> commit writes a complete fresh description of the file (groups, headers, attributes, chunk indices) into the one of two
!> areas that is not in use, and last the superblock: 48 bytes within one page, so that a kill leaves either the old or the
!> new one. Nothing that a superblock in force describes is ever overwritten.
!>
!> What is promised:
!> * after a kill at any time every committed row, attribute and text is readable by any HDF5 library from 1.8 on;
!> * a write that fails (full disk, quota) is an error and leaves the last commit in force; the file then takes no more;
!> * other programs may read while the run goes on. One that stays open for two more commits should open the file again;
!> * with `durable`, commits also survive a crash of the machine (two waits for the device per commit).
!>
!> The cost: full index leaves are written once, the rest of the description at every commit (about 2 kB per dataset, in
!> two areas that are used again). No compression, no deletion.
!>
!> Reopening: what is known of the file (`carry_append_file`) is kept elsewhere, in a checkpoint; `reopen_append_file` cuts the
!> file back to that state and goes on. That is safe because a file only grows: all that was in it then still is.
module gimp_append_file
  use, intrinsic :: iso_c_binding, only: c_loc
  use, intrinsic :: iso_fortran_env, only: real32
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_positive_inf, ieee_negative_inf, ieee_quiet_nan
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_parcel, only: parcel_t, carry
  use gimp_file_system, only: raw_file_t, create_raw_file, open_raw_file, write_at, resize_raw_file, sync_raw_file, &
    close_raw_file, file_exists, file_bytes, rename_file, delete_file
  use gimp_hdf5_format, only: bytes_t, stored_real32, stored_real64, stored_int64, stored_text, undefined_address, &
    superblock_bytes, superblock, node_width
  use gimp_append_index, only: object_t, attribute_t, a_group, a_table, a_text, row_bytes, put_leaf, describe, &
    carry_object
  implicit none(type, external)
  private
  public :: append_file_t, create_append_file, commit_append_file, close_append_file
  public :: carry_append_file, reopen_append_file, sync_append_file
  public :: make_group, make_table, append_rows, put_text, set_attribute
  public :: table_rows, find_object, stored_real32, stored_real64, stored_int64

  integer(i8), parameter :: largest_chunk = 2_i8**28 !! bytes; the format ends at 2^32

  !> An open file; the objects in it are known by number, 1 is the root group
  type :: append_file_t
    character(len=:), allocatable :: path
    logical :: is_open = .false.
    logical :: durable = .false. !! wait for the device at commits
    type(raw_file_t), private :: raw
    character(len=:), allocatable, private :: first_name ! until the first commit
    character(len=:), allocatable, private :: failure ! why the file takes no more
    type(object_t), allocatable, private :: object(:)
    integer, private :: objects = 0
    integer(i8), private :: used = superblock_bytes ! bytes given away
    integer(i8), private :: reserved = 0 ! present length of the file
    integer(i8), private :: area(2) = 0, room(2) = 0 ! where descriptions go, and how much fits
    integer, private :: active = 1
  end type append_file_t

  !> Add rows at the end of a table: values(rows) for one component, else values(components, rows)
  interface append_rows
    module procedure append_real, append_reals, append_long, append_longs
  end interface append_rows

  !> Give a group or table a named value; one of that name is replaced
  interface set_attribute
    module procedure set_real, set_integer, set_long, set_longs, set_text
  end interface set_attribute

contains

  !> Start a file. It gets its name at the first commit; until then it is called `path`.part and an older file stays
  subroutine create_append_file(path, overwrite, file, error, durable)
    character(len=*), intent(in) :: path
    logical, intent(in) :: overwrite !! else an existing file is an error
    type(append_file_t), intent(out) :: file
    type(error_t), allocatable, intent(out) :: error
    logical, intent(in), optional :: durable !! .false. if absent
    if (ichar(transfer(1, "a")) /= 1) then
      call raise(error, path//": this file format is only written on little-endian machines")
      return
    end if
    if (.not. overwrite) then
      if (file_exists(path)) then
        call raise(error, path//": is there already; allow overwriting or choose another name")
        return
      end if
    end if
    file%path = path
    file%first_name = path//".part"
    if (present(durable)) file%durable = durable
    call create_raw_file(file%first_name, file%raw, error)
    if (allocated(error)) return
    file%is_open = .true.
    allocate (file%object(64))
    file%objects = 1
    file%object(1)%kind = a_group
    file%object(1)%name = ""
  end subroutine create_append_file

  !> Make everything appended and set so far part of the file: all of it or, after a kill or an error, nothing
  subroutine commit_append_file(file, error)
    type(append_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(out) :: error
    type(bytes_t) :: description
    integer(i8) :: root
    integer :: slot

    call check_usable(file, error)
    if (allocated(error)) return
    slot = 3 - file%active
    call describe(file%object(:file%objects), 0_i8, description, root) ! only to learn its size
    if (description%n > file%room(slot)) then
      file%room(slot) = description%n + description%n/8 ! it hardly grows once every table has rows
      call take_room(file, file%room(slot), file%area(slot))
    end if
    call describe(file%object(:file%objects), file%area(slot), description, root)
    call put_on_disk(file, file%area(slot), description%data(:description%n), error)
    if (.not. allocated(error) .and. file%used > file%reserved) then
      call resize_raw_file(file%raw, file%used, error) ! readers refuse a file shorter than its superblock says
      file%reserved = file%used
    end if
    if (.not. allocated(error) .and. file%durable) call sync_raw_file(file%raw, error)
    if (.not. allocated(error)) call put_on_disk(file, 0_i8, superblock(root, file%used), error)
    if (.not. allocated(error) .and. file%durable) call sync_raw_file(file%raw, error)
    if (.not. allocated(error) .and. allocated(file%first_name)) then
      call rename_file(file%first_name, file%path, error)
      if (.not. allocated(error)) then
        deallocate (file%first_name)
        file%raw%path = file%path
      end if
    end if
    if (allocated(error)) then
      file%failure = error%message
      return
    end if
    file%active = slot
  end subroutine commit_append_file

  !> Commit and close; a file that was never committed, or could not be, is left as its last commit is
  subroutine close_append_file(file, error)
    type(append_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(out) :: error
    type(error_t), allocatable :: ignored
    if (.not. file%is_open) return
    if (.not. allocated(file%failure)) call commit_append_file(file, error)
    if (allocated(error)) then
      call close_raw_file(file%raw, ignored)
    else
      call close_raw_file(file%raw, error)
    end if
    if (allocated(file%first_name)) call delete_file(file%first_name, ignored)
    file%is_open = .false.
  end subroutine close_append_file

  !> Wait until all that was written so far is on the device, so that a state that counts on it may be kept elsewhere
  subroutine sync_append_file(file, error)
    type(append_file_t), intent(in) :: file
    type(error_t), allocatable, intent(out) :: error
    call check_usable(file, error)
    if (.not. allocated(error)) call sync_raw_file(file%raw, error)
  end subroutine sync_append_file

  !> Pack what is known of a file that was committed at least once, or unpack it for `reopen_append_file`
  pure subroutine carry_append_file(file, parcel)
    type(append_file_t), intent(inout) :: file
    type(parcel_t), intent(inout) :: parcel
    integer :: k
    call carry(parcel, file%durable)
    call carry(parcel, file%used)
    do k = 1, 2
      call carry(parcel, file%area(k))
      call carry(parcel, file%room(k))
    end do
    call carry(parcel, file%active)
    call carry(parcel, file%objects)
    if (parcel%reading .and. parcel%sound) allocate (file%object(max(64, file%objects)))
    do k = 1, file%objects
      if (.not. parcel%sound) return
      call carry_object(file%object(k), parcel)
    end do
  end subroutine carry_append_file

  !> Cut a file back to the state that was unpacked into `file`, commit that, and go on appending.
  !> A kill in between leaves the file as it was, or as it was then: a description of the old state is written beyond all
  !> that is in use and put in force; only then may the room that came after the old state be given away again.
  subroutine reopen_append_file(path, lineage, file, error)
    character(len=*), intent(in) :: path
    character(len=*), intent(in) :: lineage !! attribute of the root group from now on: who wrote the file up to where
    type(append_file_t), intent(inout) :: file !! as carry_append_file unpacked it
    type(error_t), allocatable, intent(out) :: error
    type(bytes_t) :: description
    integer(i8) :: root, length, beyond
    file%path = path
    length = file_bytes(path)
    if (length < file%used) then
      call raise(error, path//": is shorter ("//text_of(max(0_i8, length))//" bytes) than what is to be continued (" &
        //text_of(file%used)//" bytes)")
      return
    end if
    call open_raw_file(path, file%raw, error)
    if (allocated(error)) return
    file%is_open = .true.
    call set_text(file, "", "lineage", lineage, error)
    if (allocated(error)) return
    call describe(file%object(:file%objects), 0_i8, description, root) ! only to learn its size
    beyond = 8*((length + 7)/8 + description%n/2) ! the commit below may need room where the old file ends
    call describe(file%object(:file%objects), beyond, description, root)
    call put_on_disk(file, beyond, description%data(:description%n), error)
    if (.not. allocated(error)) call sync_raw_file(file%raw, error)
    if (.not. allocated(error)) call put_on_disk(file, 0_i8, superblock(root, beyond + description%n), error)
    if (.not. allocated(error)) call sync_raw_file(file%raw, error)
    if (allocated(error)) then
      file%failure = error%message
      return
    end if
    file%reserved = huge(0_i8) ! longer than needed until the old state stands at its own place
    call commit_append_file(file, error)
    if (.not. allocated(error)) call sync_raw_file(file%raw, error)
    if (.not. allocated(error)) call resize_raw_file(file%raw, file%used, error)
    file%reserved = file%used
  end subroutine reopen_append_file

  !> Make a group; its parent must exist. One that is there already is found
  subroutine make_group(file, path, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path !! as in "VTKHDF/Steps"
    type(error_t), allocatable, intent(out) :: error
    integer :: number
    number = find_object(file, path)
    if (number > 0) then
      if (file%object(number)%kind == a_group) return
    end if
    call new_object(file, path, a_group, number, error)
  end subroutine make_group

  !> Make an empty table
  subroutine make_table(file, path, stored, components, chunk_rows, table, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path !! as in "VTKHDF/Points"; its group must exist
    integer, intent(in) :: stored !! stored_real32, stored_real64 or stored_int64
    integer, intent(in) :: components !! 0 or 1 for a vector, else columns of a matrix; 0 and 1 are the same
    integer(i8), intent(in) :: chunk_rows !! rows stored together: about what is appended at a time
    integer, intent(out) :: table !! its number
    type(error_t), allocatable, intent(out) :: error
    call new_object(file, path, a_table, table, error)
    if (allocated(error)) return
    associate (new => file%object(table))
      new%stored = stored
      new%components = max(1, components)
      new%rank = merge(2, 1, components > 1)
      new%chunk_rows = max(1_i8, min(chunk_rows, largest_chunk/row_bytes(new)))
      allocate (new%chunk(16), new%leaf(1))
    end associate
  end subroutine make_table

  !> Rows of a table, committed or not
  pure integer(i8) function table_rows(file, table)
    type(append_file_t), intent(in) :: file
    integer, intent(in) :: table
    table_rows = file%object(table)%rows
  end function table_rows

  !> Number of the object at a path, 1 for the root (empty path), 0 if there is none
  pure integer function find_object(file, path) result(number)
    type(append_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer :: first, last, k, parent
    number = 1
    first = 1
    do while (first <= len(path))
      last = index(path(first:), "/") - 1
      if (last < 0) last = len(path) - first + 1
      parent = number
      number = 0
      do k = 2, file%objects
        if (file%object(k)%parent /= parent) cycle
        if (file%object(k)%name == path(first:first + last - 1)) number = k
      end do
      if (number == 0) return
      first = first + last + 1
    end do
  end function find_object

  !> Store a text as a dataset of its own; bytes are kept as they are (UTF-8)
  subroutine put_text(file, path, text, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, text
    type(error_t), allocatable, intent(out) :: error
    integer :: number
    call new_object(file, path, a_text, number, error)
    if (allocated(error)) return
    file%object(number)%length = max(1, len(text)) ! the format has no empty string of fixed length
    call take_room(file, int(file%object(number)%length, i8), file%object(number)%address)
    call put_on_disk(file, file%object(number)%address, text//repeat(char(0), max(0, 1 - len(text))), error)
    if (allocated(error)) file%failure = error%message
  end subroutine put_text

  subroutine append_real(file, table, values, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    real(dp), intent(in), contiguous :: values(:)
    type(error_t), allocatable, intent(out) :: error
    call append_real_rows(file, table, 1, size(values, kind=i8), values, error)
  end subroutine append_real

  subroutine append_reals(file, table, values, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    real(dp), intent(in), contiguous :: values(:, :)
    type(error_t), allocatable, intent(out) :: error
    call append_real_rows(file, table, size(values, 1), size(values, 2, kind=i8), values, error)
  end subroutine append_reals

  subroutine append_long(file, table, values, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    integer(i8), intent(in), contiguous :: values(:)
    type(error_t), allocatable, intent(out) :: error
    call append_long_rows(file, table, 1, size(values, kind=i8), values, error)
  end subroutine append_long

  subroutine append_longs(file, table, values, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    integer(i8), intent(in), contiguous :: values(:, :)
    type(error_t), allocatable, intent(out) :: error
    call append_long_rows(file, table, size(values, 1), size(values, 2, kind=i8), values, error)
  end subroutine append_longs

  subroutine append_real_rows(file, table, components, rows, values, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table, components
    integer(i8), intent(in) :: rows
    real(dp), intent(in), target :: values(components, rows)
    type(error_t), allocatable, intent(out) :: error
    real(real32), allocatable, target :: narrow(:, :)
    integer(i8) :: done, m, address

    call check_table(file, table, components, [stored_real32, stored_real64], error)
    if (allocated(error)) return
    done = 0
    do while (done < rows)
      call next_room(file, table, rows - done, m, address, error)
      if (allocated(error)) exit
      if (file%object(table)%stored == stored_real32) then
        narrow = single_of(values(:, done + 1:done + m))
        call write_at(file%raw, address, c_loc(narrow), 4*components*m, error)
      else
        call write_at(file%raw, address, c_loc(values(1, done + 1)), 8*components*m, error)
      end if
      if (allocated(error)) exit
      file%object(table)%rows = file%object(table)%rows + m
      done = done + m
    end do
    if (allocated(error)) file%failure = error%message
  end subroutine append_real_rows

  subroutine append_long_rows(file, table, components, rows, values, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table, components
    integer(i8), intent(in) :: rows
    integer(i8), intent(in), target :: values(components, rows)
    type(error_t), allocatable, intent(out) :: error
    integer(i8) :: done, m, address

    call check_table(file, table, components, [stored_int64], error)
    if (allocated(error)) return
    done = 0
    do while (done < rows)
      call next_room(file, table, rows - done, m, address, error)
      if (.not. allocated(error)) call write_at(file%raw, address, c_loc(values(1, done + 1)), 8*components*m, error)
      if (allocated(error)) exit
      file%object(table)%rows = file%object(table)%rows + m
      done = done + m
    end do
    if (allocated(error)) file%failure = error%message
  end subroutine append_long_rows

  !> Where the next rows of a table go and how many of them fit there; opens a chunk when the last one is full
  subroutine next_room(file, table, wanted, m, address, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    integer(i8), intent(in) :: wanted
    integer(i8), intent(out) :: m
    integer(i8), intent(out) :: address !! in the file
    type(error_t), allocatable, intent(out) :: error
    integer(i8), parameter :: piece = 2_i8**20 ! bytes converted at a time, so that a frame needs no copy of its own
    integer(i8) :: within, new
    within = mod(file%object(table)%rows, file%object(table)%chunk_rows)
    if (file%object(table)%rows == file%object(table)%chunks*file%object(table)%chunk_rows) then
      call take_room(file, file%object(table)%chunk_rows*row_bytes(file%object(table)), new)
      associate (o => file%object(table))
        call push(o%chunk, o%chunks, new)
        o%chunks = o%chunks + 1
      end associate
      if (mod(file%object(table)%chunks, int(node_width, i8)) == 0) call write_full_leaf(file, table, error)
      if (allocated(error)) return
    end if
    associate (o => file%object(table))
      m = min(wanted, o%chunk_rows - within, max(1_i8, piece/row_bytes(o)))
      address = o%chunk(o%chunks) + within*row_bytes(o)
    end associate
  end subroutine next_room

  !> An index leaf that is full never changes again: it is written once, where it stays.
  !> Its right neighbour is not known yet and left open; searches go from the root down and do not need it.
  subroutine write_full_leaf(file, table, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    type(error_t), allocatable, intent(out) :: error
    type(bytes_t) :: node
    integer(i8) :: address, first, left
    first = file%object(table)%chunks - node_width
    left = undefined_address
    if (first > 0) left = file%object(table)%leaf(file%object(table)%leaves)
    call put_leaf(node, file%object(table), first, left)
    call take_room(file, int(node%n, i8), address)
    associate (o => file%object(table))
      call push(o%leaf, o%leaves, address)
      o%leaves = o%leaves + 1
    end associate
    call put_on_disk(file, address, node%data(:node%n), error)
  end subroutine write_full_leaf

  subroutine set_real(file, path, name, value, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name
    real(dp), intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    call set_values(file, path, name, stored_real64, 0, transfer(value, repeat(" ", 8)), error)
  end subroutine set_real

  subroutine set_integer(file, path, name, value, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name
    integer, intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    call set_long(file, path, name, int(value, i8), error)
  end subroutine set_integer

  subroutine set_long(file, path, name, value, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name
    integer(i8), intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    call set_values(file, path, name, stored_int64, 0, transfer(value, repeat(" ", 8)), error)
  end subroutine set_long

  subroutine set_longs(file, path, name, value, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name
    integer(i8), intent(in) :: value(:)
    type(error_t), allocatable, intent(out) :: error
    call set_values(file, path, name, stored_int64, size(value), transfer(value, repeat(" ", 8*size(value))), error)
  end subroutine set_longs

  subroutine set_text(file, path, name, value, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name, value
    type(error_t), allocatable, intent(out) :: error
    if (len(value) > 32768) then
      call raise(error, file%path//": "//path//": text of attribute "//name//" is longer than 32768 bytes")
      return
    end if
    call set_values(file, path, name, stored_text, 0, value//repeat(char(0), max(0, 1 - len(value))), error)
  end subroutine set_text

  subroutine set_values(file, path, name, stored, length, values, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name, values
    integer, intent(in) :: stored, length
    type(error_t), allocatable, intent(out) :: error
    type(attribute_t), allocatable :: wider(:)
    integer :: number, k
    call check_usable(file, error)
    if (allocated(error)) return
    number = find_object(file, path)
    if (number == 0) then
      call raise(error, file%path//": "//path//" does not exist and cannot have an attribute "//name)
      return
    end if
    associate (o => file%object(number))
      if (.not. allocated(o%attribute)) allocate (o%attribute(4))
      do k = 1, o%attributes
        if (o%attribute(k)%name == name) exit
      end do
      if (k > size(o%attribute)) then
        allocate (wider(2*size(o%attribute)))
        wider(:size(o%attribute)) = o%attribute
        call move_alloc(wider, o%attribute)
      end if
      o%attributes = max(o%attributes, k)
      o%attribute(k)%name = name
      o%attribute(k)%stored = stored
      o%attribute(k)%length = length
      o%attribute(k)%values = values
    end associate
  end subroutine set_values

  subroutine new_object(file, path, kind, number, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path
    integer, intent(in) :: kind
    integer, intent(out) :: number
    type(error_t), allocatable, intent(out) :: error
    type(object_t), allocatable :: wider(:)
    integer :: slash, parent
    number = 0
    call check_usable(file, error)
    if (allocated(error)) return
    slash = index(path, "/", back=.true.)
    parent = find_object(file, path(:max(0, slash - 1)))
    if (parent > 0) then
      if (file%object(parent)%kind /= a_group) parent = 0
    end if
    if (parent == 0) then
      call raise(error, file%path//": no group to hold "//path)
    else if (find_object(file, path) > 0) then
      call raise(error, file%path//": "//path//" exists already")
    else if (len(path) == slash .or. len(path) - slash > 255) then
      call raise(error, file%path//": "//path//" is no name; it needs 1 to 255 characters after the last slash")
    end if
    if (allocated(error)) return
    if (file%objects == size(file%object)) then
      allocate (wider(2*file%objects))
      wider(:file%objects) = file%object
      call move_alloc(wider, file%object)
    end if
    file%objects = file%objects + 1
    number = file%objects
    file%object(number)%kind = kind
    file%object(number)%parent = parent
    file%object(number)%name = path(slash + 1:)
  end subroutine new_object

  subroutine check_usable(file, error)
    type(append_file_t), intent(in) :: file
    type(error_t), allocatable, intent(out) :: error
    if (.not. file%is_open) then
      call raise(error, "a file that is not open cannot be written")
    else if (allocated(file%failure)) then
      call raise(error, file%failure)
    end if
  end subroutine check_usable

  subroutine check_table(file, table, components, kinds, error)
    type(append_file_t), intent(in) :: file
    integer, intent(in) :: table, components, kinds(:)
    type(error_t), allocatable, intent(out) :: error
    call check_usable(file, error)
    if (allocated(error)) return
    associate (o => file%object(table))
      if (components /= o%components) then
        call raise(error, file%path//": table "//o%name//" has "//text_of(o%components)//" components, got " &
          //text_of(components))
      else if (all(kinds /= o%stored)) then
        call raise(error, file%path//": table "//o%name//" holds the other kind of number (real or integer)")
      end if
    end associate
  end subroutine check_table

  !> Give away the next bytes of the file, at a multiple of eight
  pure subroutine take_room(file, bytes, address)
    type(append_file_t), intent(inout) :: file
    integer(i8), intent(in) :: bytes
    integer(i8), intent(out) :: address
    address = 8*((file%used + 7)/8)
    file%used = address + bytes
  end subroutine take_room

  subroutine put_on_disk(file, address, text, error)
    type(append_file_t), intent(in) :: file
    integer(i8), intent(in) :: address
    character(len=*), intent(in), target :: text
    type(error_t), allocatable, intent(out) :: error
    call write_at(file%raw, address, c_loc(text), len(text, kind=i8), error)
  end subroutine put_on_disk

  pure subroutine push(list, n, value)
    integer(i8), allocatable, intent(inout) :: list(:)
    integer(i8), intent(in) :: n !! entries before
    integer(i8), intent(in) :: value
    integer(i8), allocatable :: wider(:)
    if (n == size(list, kind=i8)) then
      allocate (wider(2*n))
      wider(:n) = list
      call move_alloc(wider, list)
    end if
    list(n + 1) = value
  end subroutine push

  !> Single precision; what is too large becomes infinite, without raising a floating-point exception
  elemental real(real32) function single_of(value)
    real(dp), intent(in) :: value
    if (value /= value) then ! first, because other comparisons with NaN raise an exception
      single_of = ieee_value(single_of, ieee_quiet_nan)
    else if (abs(value) <= real(huge(1.0_real32), dp)) then
      single_of = real(value, real32)
    else if (value > 0.0_dp) then
      single_of = ieee_value(single_of, ieee_positive_inf)
    else
      single_of = ieee_value(single_of, ieee_negative_inf)
    end if
  end function single_of

end module gimp_append_file
