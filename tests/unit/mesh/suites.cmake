gimp_add_unit_test(mesh test_blocks)
gimp_add_unit_test(mesh test_images)
gimp_add_unit_test(mesh test_related)
gimp_add_unit_test(mesh test_mesh_connect USES made_meshes)
