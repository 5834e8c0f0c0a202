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
!> * a write that fails (full disk, quota) is told by the next commit, which leaves the last one in force; the file then takes
!>   no more;
!> * other programs may read while the run goes on. One that stays open for two more commits should open the file again;
!> * with `durable`, commits also survive a crash of the machine (two waits for the device per commit).
!>
!> The cost: full index leaves are written once, the rest of the description at every commit (about 2 kB per dataset, in
!> two areas that are used again). No compression, no deletion.
!>
!> Several ranks write one file without a parallel library. All make the same calls (groups, tables, rows, commits), so that each
!> knows where everything goes; rank 0 writes what all know, and each rank the bytes of its own slab of rows (`append_slab`). The
!> commit of rank 0 comes after the writes of all, and only if none failed. The file does not tell how many ranks wrote it.
!>
!> Reopening: what is known of the file (`carry_append_file`) is kept elsewhere, in a checkpoint; `reopen_append_file` cuts the
!> file back to that state and goes on. That is safe because a file only grows: all that was in it then still is.
module gimp_append_file
  use gimp_common_kinds, only: i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_parcel, only: parcel_t, carry
  use gimp_ranks, only: this_rank, ranks, share_words
  use gimp_over_ranks, only: share_error
  use gimp_file_system, only: create_raw_file, open_raw_file, resize_raw_file, sync_raw_file, close_raw_file, file_exists, &
    file_bytes, rename_file, delete_file
  use gimp_hdf5_format, only: bytes_t, stored_real32, stored_real64, stored_int64, superblock
  use gimp_append_index, only: a_group, a_table, a_text, row_bytes, describe, carry_object
  use gimp_append_state, only: append_file_t, find_object, new_object, check_usable, take_room, put_on_disk
  use gimp_append_attributes, only: set_attribute
  use gimp_append_rows, only: append_rows, append_slab, table_rows
  implicit none(type, external)
  private
  public :: append_file_t, create_append_file, commit_append_file, close_append_file
  public :: carry_append_file, reopen_append_file, sync_append_file
  public :: make_group, make_table, append_rows, append_slab, table_rows, put_text, set_attribute
  public :: find_object, stored_real32, stored_real64, stored_int64

  integer(i8), parameter :: largest_chunk = 2_i8**28 !! bytes; the format ends at 2^32

contains

  !> Start a file. It gets its name at the first commit; until then it is called `path`.part and an older file stays. Collective
  subroutine create_append_file(path, overwrite, file, error, durable)
    character(len=*), intent(in) :: path
    logical, intent(in) :: overwrite !! else an existing file is an error
    type(append_file_t), intent(out) :: file
    type(error_t), allocatable, intent(out) :: error
    logical, intent(in), optional :: durable !! .false. if absent
    type(error_t), allocatable :: ignored
    if (ichar(transfer(1, "a")) /= 1) then
      call raise(error, path//": this file format is only written on little-endian machines")
      return
    end if
    file%path = path
    file%first_name = path//".part"
    if (present(durable)) file%durable = durable
    if (this_rank == 0) call create_first(path, overwrite, file, error)
    call share_error(error)
    if (allocated(error)) return
    call open_beside(file%first_name, file, error)
    if (allocated(error)) then
      if (this_rank == 0) call delete_file(file%first_name, ignored)
      return
    end if
    file%is_open = .true.
    allocate (file%object(64))
    file%objects = 1
    file%object(1)%kind = a_group
    file%object(1)%name = ""
  end subroutine create_append_file

  !> Rank 0 makes the file
  subroutine create_first(path, overwrite, file, error)
    character(len=*), intent(in) :: path
    logical, intent(in) :: overwrite
    type(append_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(out) :: error
    if (.not. overwrite) then
      if (file_exists(path)) then
        call raise(error, path//": is there already; allow overwriting or choose another name")
        return
      end if
    end if
    call create_raw_file(file%first_name, file%raw, error)
  end subroutine create_first

  !> The other ranks open the file that rank 0 has open. Collective
  subroutine open_beside(path, file, error)
    character(len=*), intent(in) :: path
    type(append_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(out) :: error
    type(error_t), allocatable :: ignored
    if (this_rank > 0) call open_raw_file(path, file%raw, error)
    if (allocated(error)) &
      error%message = error%message//" Rank "//text_of(this_rank)//" does not see a file of rank 0: all ranks need the same folder"
    call share_error(error)
    if (allocated(error)) call close_raw_file(file%raw, ignored)
  end subroutine open_beside

  !> Make everything appended and set so far part of the file: all of it or, after a kill or an error, nothing. Collective
  subroutine commit_append_file(file, error)
    type(append_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(out) :: error
    integer :: slot

    call check_usable(file, error)
    if (allocated(error)) return
    if (file%durable .and. this_rank > 0 .and. .not. allocated(file%trouble)) call sync_raw_file(file%raw, file%trouble)
    call tell_trouble(file, error) ! nothing is committed before all ranks have written
    if (allocated(error)) return
    slot = 3 - file%active
    if (this_rank == 0) call put_description(file, slot)
    call tell_trouble(file, error)
    if (allocated(error)) return
    call share_room(file)
    file%active = slot
    if (.not. allocated(file%first_name)) return
    deallocate (file%first_name)
    file%raw%path = file%path
  end subroutine commit_append_file

  !> Write a description of all there is and put it in force: rank 0 alone
  subroutine put_description(file, slot)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: slot !! area that is not in use
    type(bytes_t) :: description
    integer(i8) :: root
    call describe(file%object(:file%objects), 0_i8, description, root) ! only to learn its size
    if (description%n > file%room(slot)) then
      file%room(slot) = description%n + description%n/8 ! it hardly grows once every table has rows
      call take_room(file, file%room(slot), file%area(slot))
    end if
    call describe(file%object(:file%objects), file%area(slot), description, root)
    call put_on_disk(file, file%area(slot), description%data(:description%n))
    if (.not. allocated(file%trouble) .and. file%used > file%reserved) then
      call resize_raw_file(file%raw, file%used, file%trouble) ! readers refuse a file shorter than its superblock says
      file%reserved = file%used
    end if
    if (.not. allocated(file%trouble) .and. file%durable) call sync_raw_file(file%raw, file%trouble)
    call put_on_disk(file, 0_i8, superblock(root, file%used))
    if (.not. allocated(file%trouble) .and. file%durable) call sync_raw_file(file%raw, file%trouble)
    if (.not. allocated(file%trouble) .and. allocated(file%first_name)) &
      call rename_file(file%first_name, file%path, file%trouble)
  end subroutine put_description

  !> If any rank was in trouble the file takes no more, and all ranks know why. Collective
  subroutine tell_trouble(file, error)
    type(append_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(inout) :: error
    if (allocated(file%trouble)) error = file%trouble
    call share_error(error)
    if (allocated(error)) file%failure = error%message
  end subroutine tell_trouble

  !> Room that rank 0 gave away while others did not: for descriptions. Collective
  subroutine share_room(file)
    type(append_file_t), intent(inout) :: file
    integer(i8) :: words(6)
    if (ranks == 1) return
    words = [file%used, file%reserved, file%area, file%room]
    call share_words(0, words)
    file%used = words(1)
    file%reserved = words(2)
    file%area = words(3:4)
    file%room = words(5:6)
  end subroutine share_room

  !> Commit and close; a file that was never committed, or could not be, is left as its last commit is. Collective
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
      call share_error(error)
    end if
    if (allocated(file%first_name) .and. this_rank == 0) call delete_file(file%first_name, ignored)
    file%is_open = .false.
  end subroutine close_append_file

  !> Wait until all that was written so far is on the device, so that a state that counts on it may be kept elsewhere. Collective
  subroutine sync_append_file(file, error)
    type(append_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(out) :: error
    call check_usable(file, error)
    if (allocated(error)) return
    if (.not. allocated(file%trouble)) call sync_raw_file(file%raw, file%trouble)
    call tell_trouble(file, error)
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
  !> that is in use and put in force; only then may the room that came after the old state be given away again. Collective
  subroutine reopen_append_file(path, lineage, file, error)
    character(len=*), intent(in) :: path
    character(len=*), intent(in) :: lineage !! attribute of the root group from now on: who wrote the file up to where
    type(append_file_t), intent(inout) :: file !! as carry_append_file unpacked it, on all ranks
    type(error_t), allocatable, intent(out) :: error
    integer(i8) :: length
    file%path = path
    if (this_rank == 0) then
      length = file_bytes(path)
      if (length < file%used) then
        call raise(error, path//": is shorter ("//text_of(max(0_i8, length))//" bytes) than what is to be continued (" &
          //text_of(file%used)//" bytes)")
      else
        call open_raw_file(path, file%raw, error)
      end if
    end if
    call share_error(error)
    if (.not. allocated(error)) call open_beside(path, file, error)
    if (allocated(error)) return
    file%is_open = .true.
    call set_attribute(file, "", "lineage", lineage, error)
    if (allocated(error)) return
    if (this_rank == 0) call put_description_beyond(file, length)
    call tell_trouble(file, error)
    if (allocated(error)) return
    file%reserved = huge(0_i8) ! longer than needed until the old state stands at its own place
    call commit_append_file(file, error)
    if (allocated(error)) return
    if (this_rank == 0) call sync_raw_file(file%raw, file%trouble)
    if (this_rank == 0 .and. .not. allocated(file%trouble)) call resize_raw_file(file%raw, file%used, file%trouble)
    call tell_trouble(file, error)
    file%reserved = file%used
  end subroutine reopen_append_file

  !> Put a description in force that stands after all that is in the file: rank 0 alone
  subroutine put_description_beyond(file, length)
    type(append_file_t), intent(inout) :: file
    integer(i8), intent(in) :: length !! of the file now [bytes]
    type(bytes_t) :: description
    integer(i8) :: root, beyond
    call describe(file%object(:file%objects), 0_i8, description, root) ! only to learn its size
    beyond = 8*((length + 7)/8 + description%n/2) ! the commit that follows may need room where the old file ends
    call describe(file%object(:file%objects), beyond, description, root)
    call put_on_disk(file, beyond, description%data(:description%n))
    if (.not. allocated(file%trouble)) call sync_raw_file(file%raw, file%trouble)
    call put_on_disk(file, 0_i8, superblock(root, beyond + description%n))
    if (.not. allocated(file%trouble)) call sync_raw_file(file%raw, file%trouble)
  end subroutine put_description_beyond

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

  !> Store a text that all ranks know as a dataset of its own; bytes are kept as they are (UTF-8)
  subroutine put_text(file, path, text, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, text
    type(error_t), allocatable, intent(out) :: error
    integer :: number
    call new_object(file, path, a_text, number, error)
    if (allocated(error)) return
    file%object(number)%length = max(1, len(text)) ! the format has no empty string of fixed length
    call take_room(file, int(file%object(number)%length, i8), file%object(number)%address)
    call put_on_disk(file, file%object(number)%address, text//repeat(char(0), max(0, 1 - len(text))))
  end subroutine put_text

end module gimp_append_file
