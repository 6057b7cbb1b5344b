defmodule Situ.Test.PropertyTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Test.Property
  doctest Situ.Test.Generators

  property "a true property passes" do
    forall {xs, ys} <- {list(integer()), list(integer())} do
      assert length(xs ++ ys) == length(xs) + length(ys)
    end
  end

  property "timed/2 generates strictly increasing times" do
    forall messages <- timed_values(integer()) do
      times = Enum.map(messages, &elem(&1, 0))
      assert times == Enum.uniq(Enum.sort(times))
    end
  end

  property "batches/1 loses nothing" do
    forall {batches, items} <-
             map(list(integer()), fn items -> {random_batches(items), constant(items)} end) do
      assert Enum.concat(batches) == items
    end
  end

  test "a failure shows the shrunk input and its error" do
    error =
      assert_raise ExUnit.AssertionError, fn ->
        Situ.Test.Property.check_forall({list(integer()), fn xs -> assert length(xs) < 3 end})
      end

    assert error.message =~ "input: [0, 0, 0]"
    assert error.message =~ "length(xs) < 3"
  end

  test "false is also a counterexample" do
    error =
      assert_raise ExUnit.AssertionError, fn ->
        Situ.Test.Property.check_forall({integer(), fn n -> n < 1_000_000 and n > -1 end})
      end

    assert error.message =~ "returned false"
  end
end
