!> Names of files, and bytes at a place of our choosing
program test_file_system
  use, intrinsic :: iso_c_binding, only: c_loc
  use gimp_common_kinds, only: i8
  use gimp_error, only: error_t
  use gimp_file_system, only: file_exists, folder_writable, folder_of, rename_file, delete_file, raw_file_t, create_raw_file, &
    write_at, resize_raw_file, sync_raw_file, close_raw_file
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_file_system.bin"
  call begin_suite("file_system")
  call names_and_folders()
  call bytes_land_where_told()
  call end_suite()

contains

  subroutine names_and_folders()
    type(error_t), allocatable :: error
    call check(folder_of("a/b/c.h5"), "a/b", "folder of a path")
    call check(folder_of("c.h5"), ".", "folder of a bare name")
    call check(folder_of("/c.h5"), "/", "folder of a name at the root")
    call check_true(folder_writable("."), "the current folder is writable")
    call check_true(folder_writable(""), "an empty name is the current folder")
    call check_true(.not. folder_writable("no/such/folder"), "a folder that is not there is not writable")
    call rename_file("no_such_file", "other", error)
    call check_true(allocated(error), "a file that is not there cannot be renamed")
    if (allocated(error)) call check_true(index(error%message, "no_such_file") == 1, "the message names the file")
    call delete_file("no_such_file", error)
    call check_true(.not. allocated(error), "removing a file that is not there is no error")
  end subroutine names_and_folders

  subroutine bytes_land_where_told()
    type(raw_file_t) :: file
    type(error_t), allocatable :: error
    character(len=4), target :: text
    character(len=10) :: content
    integer :: unit, length
    call create_raw_file("no/such/folder/file", file, error)
    call check_true(allocated(error), "a file in a folder that is not there cannot be made")
    call create_raw_file(name//".part", file, error)
    call check_true(.not. allocated(error), "a file can be made")
    text = "abcd"
    call write_at(file, 6_i8, c_loc(text), 4_i8, error)
    call check_true(.not. allocated(error), "bytes can be written past the end")
    text = "wxyz"
    call write_at(file, 1_i8, c_loc(text), 4_i8, error)
    call sync_raw_file(file, error)
    call check_true(.not. allocated(error), "the file can be brought to disk")
    call resize_raw_file(file, 100_i8, error)
    call close_raw_file(file, error)
    call check_true(.not. allocated(error), "the file can be closed")
    call rename_file(name//".part", name, error)
    call check_true(file_exists(name), "renaming gives the new name")
    call check_true(.not. file_exists(name//".part"), "and takes the old one")
    open (newunit=unit, file=name, access="stream", form="unformatted", action="read")
    read (unit) content
    inquire (unit, size=length)
    close (unit)
    call check(content, char(0)//"wxyz"//char(0)//"abcd", "content of the file")
    call check(length, 100, "length of the file")
    call delete_file(name, error)
    call check_true(.not. file_exists(name), "the file is removed")
  end subroutine bytes_land_where_told

end program test_file_system
