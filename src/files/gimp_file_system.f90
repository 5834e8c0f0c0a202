!> Files as the operating system sees them: names, and bytes written at a place of our choosing.
!>
!> Fortran's own input and output has no rename, and its buffers decide when (and whether) an error of the disk is told; both
!> matter for files that must survive a kill and a full disk. Hence these few calls of POSIX, none of which is variadic.
module gimp_file_system
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_int64_t, c_size_t, c_long, c_ptr, c_null_ptr, c_associated, &
    c_null_char
  use gimp_common_kinds, only: i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  implicit none(type, external)
  private
  public :: peak_memory, file_exists, folder_writable, folder_of, rename_file, delete_file
  public :: raw_file_t, create_raw_file, open_raw_file, file_bytes, write_at, read_at, resize_raw_file, sync_raw_file, close_raw_file

  !> An open file, without any buffer of ours or of the runtime
  type :: raw_file_t
    character(len=:), allocatable :: path !! for messages
    type(c_ptr) :: stream = c_null_ptr !! the C stream that owns the descriptor
    integer(c_int) :: descriptor = -1
  end type raw_file_t

  interface
    integer(c_int) function c_rename(from, to) bind(c, name="rename")
      import :: c_int, c_char
      implicit none(type, external)
      character(kind=c_char), intent(in) :: from(*), to(*)
    end function c_rename

    integer(c_int) function c_remove(path) bind(c, name="remove")
      import :: c_int, c_char
      implicit none(type, external)
      character(kind=c_char), intent(in) :: path(*)
    end function c_remove

    integer(c_int) function c_access(path, mode) bind(c, name="access")
      import :: c_int, c_char
      implicit none(type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value :: mode
    end function c_access

    type(c_ptr) function c_fopen(path, mode) bind(c, name="fopen")
      import :: c_ptr, c_char
      implicit none(type, external)
      character(kind=c_char), intent(in) :: path(*), mode(*)
    end function c_fopen

    integer(c_int) function c_fclose(stream) bind(c, name="fclose")
      import :: c_int, c_ptr
      implicit none(type, external)
      type(c_ptr), value :: stream
    end function c_fclose

    integer(c_int) function c_fileno(stream) bind(c, name="fileno")
      import :: c_int, c_ptr
      implicit none(type, external)
      type(c_ptr), value :: stream
    end function c_fileno

    integer(c_long) function c_pwrite(descriptor, buffer, count, offset) bind(c, name="pwrite")
      import :: c_long, c_int, c_size_t, c_int64_t, c_ptr
      implicit none(type, external)
      integer(c_int), value :: descriptor
      type(c_ptr), value :: buffer
      integer(c_size_t), value :: count
      integer(c_int64_t), value :: offset
    end function c_pwrite

    integer(c_long) function c_pread(descriptor, buffer, count, offset) bind(c, name="pread")
      import :: c_long, c_int, c_size_t, c_int64_t, c_ptr
      implicit none(type, external)
      integer(c_int), value :: descriptor
      type(c_ptr), value :: buffer
      integer(c_size_t), value :: count
      integer(c_int64_t), value :: offset
    end function c_pread

    integer(c_int) function c_ftruncate(descriptor, length) bind(c, name="ftruncate")
      import :: c_int, c_int64_t
      implicit none(type, external)
      integer(c_int), value :: descriptor
      integer(c_int64_t), value :: length
    end function c_ftruncate

    integer(c_int) function c_fsync(descriptor) bind(c, name="fsync")
      import :: c_int
      implicit none(type, external)
      integer(c_int), value :: descriptor
    end function c_fsync
  end interface

contains

  !> Whether something of that name is there
  logical function file_exists(path)
    character(len=*), intent(in) :: path
    file_exists = c_access(path//c_null_char, 0_c_int) == 0
  end function file_exists

  !> Whether new files can be made in a folder; an empty name means the current folder
  logical function folder_writable(folder)
    character(len=*), intent(in) :: folder
    integer(c_int), parameter :: write_and_search = 3
    character(len=:), allocatable :: name
    name = folder
    if (len(name) == 0) name = "."
    ! the dot makes a plain file of that name fail
    folder_writable = c_access(name//"/."//c_null_char, write_and_search) == 0
  end function folder_writable

  !> The folder part of a path, "." when it has none
  pure function folder_of(path) result(folder)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: folder
    integer :: slash
    slash = index(path, "/", back=.true.)
    if (slash == 0) then
      folder = "."
    else if (slash == 1) then
      folder = "/"
    else
      folder = path(:slash - 1)
    end if
  end function folder_of

  !> Give a file another name in one indivisible act; a file that had that name is replaced
  subroutine rename_file(from, to, error)
    character(len=*), intent(in) :: from, to
    type(error_t), allocatable, intent(out) :: error
    if (c_rename(from//c_null_char, to//c_null_char) == 0) return
    call raise(error, from//": cannot be renamed to "//to)
  end subroutine rename_file

  !> Remove a file; one that is not there is no error
  subroutine delete_file(path, error)
    character(len=*), intent(in) :: path
    type(error_t), allocatable, intent(out) :: error
    if (.not. file_exists(path)) return
    if (c_remove(path//c_null_char) == 0) return
    call raise(error, path//": cannot be removed")
  end subroutine delete_file

  !> Make an empty file, or empty the one that is there, and open it for writing
  subroutine create_raw_file(path, file, error)
    character(len=*), intent(in) :: path
    type(raw_file_t), intent(out) :: file
    type(error_t), allocatable, intent(out) :: error
    file%path = path
    file%stream = c_fopen(path//c_null_char, "wb"//c_null_char)
    if (.not. c_associated(file%stream)) then
      call raise(error, path//": cannot be created; is the folder there and writable?")
      return
    end if
    file%descriptor = c_fileno(file%stream)
  end subroutine create_raw_file

  !> Open a file that is there for writing, and leave what is in it; or only for reading
  subroutine open_raw_file(path, file, error, only_read)
    character(len=*), intent(in) :: path
    type(raw_file_t), intent(out) :: file
    type(error_t), allocatable, intent(out) :: error
    logical, intent(in), optional :: only_read
    logical :: reads
    reads = .false.
    if (present(only_read)) reads = only_read
    file%path = path
    file%stream = c_fopen(path//c_null_char, trim(merge("rb ", "r+b", reads))//c_null_char)
    if (.not. c_associated(file%stream)) then
      if (reads) call raise(error, path//": cannot be opened for reading; is it there and readable?")
      if (.not. reads) call raise(error, path//": cannot be opened for writing; is it there and writable?")
      return
    end if
    file%descriptor = c_fileno(file%stream)
  end subroutine open_raw_file

  !> Most memory that this process has held so far [bytes]; 0 where the system does not tell (Linux does)
  integer(i8) function peak_memory() result(bytes)
    character(len=80) :: text
    integer :: unit, status
    bytes = 0
    open (newunit=unit, file="/proc/self/status", action="read", status="old", iostat=status)
    if (status /= 0) return
    do
      read (unit, "(a)", iostat=status) text
      if (status /= 0) exit
      if (text(:6) /= "VmHWM:") cycle
      read (text(7:), *, iostat=status) bytes
      bytes = 1024*bytes
      exit
    end do
    close (unit)
  end function peak_memory

  !> Length of a file in bytes, -1 when it is not there
  integer(i8) function file_bytes(path)
    character(len=*), intent(in) :: path
    inquire (file=path, size=file_bytes)
  end function file_bytes

  !> Write bytes at a place; either all of them are handed to the system or there is an error
  subroutine write_at(file, offset, buffer, bytes, error)
    type(raw_file_t), intent(in) :: file
    integer(i8), intent(in) :: offset !! bytes from the start of the file
    type(c_ptr), intent(in) :: buffer
    integer(i8), intent(in) :: bytes
    type(error_t), allocatable, intent(out) :: error
    integer(i8) :: done
    integer(c_long) :: written
    done = 0
    do while (done < bytes) ! a write may stop short at a signal or just before the disk is full
      written = c_pwrite(file%descriptor, shifted(buffer, done), int(bytes - done, c_size_t), &
        int(offset + done, c_int64_t))
      if (written <= 0) then
        call raise(error, file%path//": writing "//text_of(bytes - done)//" bytes at offset "//text_of(offset + done) &
          //" failed; is the disk full or a quota used up?")
        return
      end if
      done = done + written
    end do
  end subroutine write_at

  !> Read bytes from a place; either all of them come or there is an error
  subroutine read_at(file, offset, buffer, bytes, error)
    type(raw_file_t), intent(in) :: file
    integer(i8), intent(in) :: offset !! bytes from the start of the file
    type(c_ptr), intent(in) :: buffer
    integer(i8), intent(in) :: bytes
    type(error_t), allocatable, intent(out) :: error
    integer(i8) :: done
    integer(c_long) :: got
    done = 0
    do while (done < bytes)
      got = c_pread(file%descriptor, shifted(buffer, done), int(bytes - done, c_size_t), int(offset + done, c_int64_t))
      if (got <= 0) then
        call raise(error, file%path//": cannot be read from byte "//text_of(offset + done)//" on; is it cut short?")
        return
      end if
      done = done + got
    end do
  end subroutine read_at

  !> Set the length of a file; new bytes read as zero and take no room on most file systems
  subroutine resize_raw_file(file, bytes, error)
    type(raw_file_t), intent(in) :: file
    integer(i8), intent(in) :: bytes
    type(error_t), allocatable, intent(out) :: error
    if (c_ftruncate(file%descriptor, int(bytes, c_int64_t)) == 0) return
    call raise(error, file%path//": cannot be given a length of "//text_of(bytes)//" bytes; is the disk full?")
  end subroutine resize_raw_file

  !> Wait until everything written so far is on the device
  subroutine sync_raw_file(file, error)
    type(raw_file_t), intent(in) :: file
    type(error_t), allocatable, intent(out) :: error
    if (c_fsync(file%descriptor) == 0) return
    call raise(error, file%path//": the system could not bring the data to disk; is it full?")
  end subroutine sync_raw_file

  subroutine close_raw_file(file, error)
    type(raw_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(out) :: error
    integer(c_int) :: status
    if (.not. c_associated(file%stream)) return
    status = c_fclose(file%stream)
    file%stream = c_null_ptr
    file%descriptor = -1
    if (status /= 0) call raise(error, file%path//": closing failed; is the disk full?")
  end subroutine close_raw_file

  !> A pointer some bytes further on
  pure type(c_ptr) function shifted(pointer, bytes)
    type(c_ptr), intent(in) :: pointer
    integer(i8), intent(in) :: bytes
    shifted = transfer(transfer(pointer, 0_i8) + bytes, pointer)
  end function shifted

end module gimp_file_system
