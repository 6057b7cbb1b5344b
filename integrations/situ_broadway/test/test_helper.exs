# The helpers of Situ's own tests.
for file <- ["budget.ex", "generators.ex", "property.ex"],
    do: Code.require_file("../../../apps/situ_types/test/support/#{file}", __DIR__)

ExUnit.start()
