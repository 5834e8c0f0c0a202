gimp_add_unit_test(basis test_basis)
gimp_add_unit_test(basis test_domains)
gimp_add_unit_test(basis test_splines)
