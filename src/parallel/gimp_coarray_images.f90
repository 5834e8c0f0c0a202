!> Images of coarrays: all that is said in coarrays is said here, in words of 64 bits.
!>
!> This file alone is compiled with -fcoarray=lib: with it gfortran lays out types that have allocatable components in another
!> way, so that nothing else could use them. Hence no such type in here, and the program starts and ends the library by its
!> documented entries, which a main program compiled with it would do by itself.
module gimp_coarray_images
  use, intrinsic :: iso_c_binding, only: c_ptr, c_null_ptr, c_char, c_int, c_null_char
  use gimp_common_kinds, only: i8
  implicit none(type, external)
  private
  public :: start_images, end_images, abort_images, sync_images, share_over_images, sum_over_images, largest_over_images, &
            make_room, put_words, take_words

  integer(i8), allocatable :: mailbox(:)[:] !! what others put words into; as large on every image
  integer(i8), parameter :: most = 2_i8**27 !! words in one call: the library counts bytes in 32 bits

  interface
    subroutine caf_init(argument_count, arguments) bind(C, name="_gfortran_caf_init")
      import :: c_ptr
      implicit none(type, external)
      type(c_ptr), value :: argument_count, arguments
    end subroutine caf_init
    subroutine caf_finalize() bind(C, name="_gfortran_caf_finalize")
      implicit none(type, external)
    end subroutine caf_finalize
    integer(c_int) function c_setenv(name, value, overwrite) bind(C, name="setenv")
      import :: c_char, c_int
      implicit none(type, external)
      character(kind=c_char), intent(in) :: name(*), value(*)
      integer(c_int), value :: overwrite
    end function c_setenv
  end interface

contains

  !> Join the other images
  subroutine start_images(image, images)
    integer, intent(out) :: image !! from 1
    integer, intent(out) :: images
    call provide_for_one()
    call caf_init(c_null_ptr, c_null_ptr)
    image = this_image()
    images = num_images()
    call make_room(0_i8)
  end subroutine start_images

  !> Debian's settings of Open MPI (osc = ^ucx,pt2pt) leave an image that is alone without any way to put words, and it would not
  !> start. What the user has set stays.
  subroutine provide_for_one()
    character(len=8) :: images
    integer :: of_mpirun, of_srun, of_others, ignored
    call get_environment_variable("OMPI_COMM_WORLD_SIZE", images, status=of_mpirun)
    call get_environment_variable("PMIX_RANK", status=of_srun)
    call get_environment_variable("PMI_RANK", status=of_others)
    if (of_mpirun == 0 .and. images /= "1") return
    if (of_mpirun /= 0 .and. (of_srun == 0 .or. of_others == 0)) return
    ignored = c_setenv("OMPI_MCA_osc"//c_null_char, "^ucx"//c_null_char, 0)
  end subroutine provide_for_one

  !> Leave the others, who leave as well; the program goes on alone. Collective
  subroutine end_images()
    deallocate (mailbox)
    call caf_finalize()
  end subroutine end_images

  !> End all images at once
  subroutine abort_images(code)
    integer, intent(in) :: code
    error stop code, quiet=.true.
  end subroutine abort_images

  !> Nobody goes on before all have come here
  subroutine sync_images()
    sync all
  end subroutine sync_images

  !> All get the words of one image. Collective
  subroutine share_over_images(image, words)
    integer, intent(in) :: image
    integer(i8), intent(inout), contiguous :: words(:)
    integer(i8) :: i
    do i = 1, size(words, kind=i8), most
      call co_broadcast(words(i:min(i + most - 1, size(words, kind=i8))), source_image=image)
    end do
  end subroutine share_over_images

  !> Sums over all images. Collective
  subroutine sum_over_images(words)
    integer(i8), intent(inout), contiguous :: words(:)
    if (size(words) > 0) call co_sum(words)
  end subroutine sum_over_images

  !> Largest words of all images. Collective
  subroutine largest_over_images(words)
    integer(i8), intent(inout), contiguous :: words(:)
    if (size(words) > 0) call co_max(words)
  end subroutine largest_over_images

  !> Mailboxes of at least so many words, the most that any image needs; what was in them is lost. Collective
  subroutine make_room(words)
    integer(i8), intent(in) :: words
    integer(i8) :: needed(1)
    needed = words
    call co_max(needed)
    if (allocated(mailbox)) then
      if (size(mailbox, kind=i8) >= needed(1)) return
      deallocate (mailbox)
    end if
    allocate (mailbox(needed(1) + needed(1)/4 + 1024) [*])
  end subroutine make_room

  !> Put words into the mailbox of an image, from word `at` on
  subroutine put_words(words, image, at)
    integer(i8), intent(in), contiguous :: words(:)
    integer, intent(in) :: image
    integer(i8), intent(in) :: at
    integer(i8) :: i, n
    do i = 1, size(words, kind=i8), most
      n = min(most, size(words, kind=i8) - i + 1)
      mailbox(at + i - 1:at + i + n - 2) [image] = words(i:i + n - 1)
    end do
  end subroutine put_words

  !> Words from the own mailbox, from word `at` on
  subroutine take_words(words, at)
    integer(i8), intent(out), contiguous :: words(:)
    integer(i8), intent(in) :: at
    words = mailbox(at:at + size(words, kind=i8) - 1)
  end subroutine take_words

end module gimp_coarray_images
