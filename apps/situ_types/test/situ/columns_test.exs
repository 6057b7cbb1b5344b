defmodule Situ.ColumnsTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Columns, Error, Message}
  alias Situ.Columns.Validation

  doctest Columns

  defp values,
    do: one_of([list(integer(-(2 ** 63), 2 ** 63 - 1)), list(float()), list(boolean())])

  # Messages whose times, creation times and ids are as in a stream.
  defp messages(values) do
    for {value, n} <- Enum.with_index(values) do
      time = 1_795_000_000_000_000_000 + n * n + n

      %Message{
        data: value,
        originating_time: time,
        creation_time: time + div(n, 3),
        sequence_id: n + 5,
        source_id: 3
      }
    end
  end

  property "messages become columns and messages again" do
    forall values <- values() do
      values == [] or
        with {:ok, columns} <- Columns.from_messages(messages(values)) do
          assert Columns.messages(columns) === messages(values)
          assert Columns.values(columns) === values
          assert Columns.first_time(columns) == hd(messages(values)).originating_time
          assert Columns.last_time(columns) == List.last(messages(values)).originating_time
        end
    end
  end

  property "slices have the same messages as parts of the list" do
    forall {values, from, count} <- {values(), integer(0, 20), integer(1, 20)} do
      messages = messages(values)

      with true <- from + count <= length(values) do
        {:ok, columns} = Columns.from_messages(messages)
        slice = Columns.slice(columns, from, count)
        assert Columns.messages(slice) === Enum.slice(messages, from, count)
        parts = columns |> Columns.split(count) |> Enum.flat_map(&Columns.messages/1)
        assert parts === messages
        %{originating_time: time} = Enum.at(messages, from)
        assert Columns.count_until(columns, time) == from + 1
        assert Columns.count_until(columns, time - 1) == from
      end

      true
    end
  end

  property "the first time that does not increase is found" do
    step = one_of([integer(-2, 3), integer(-(2 ** 40), 2 ** 40)])

    forall {start, steps} <- {integer(-(2 ** 60), 2 ** 60), list(step)} do
      times = Enum.scan([start | steps], &(&1 + &2))
      columns = Columns.new(times, Enum.map(times, fn _ -> 0 end))

      expected =
        times |> Enum.zip(tl(times)) |> Enum.find_value(fn {a, b} -> if b <= a, do: {b, a} end)

      assert Validation.find_unordered(columns, nil) == expected
      assert Validation.find_unordered(columns, start) == {start, start}
      assert Validation.find_unordered(columns, start - 1) == expected
    end
  end

  test "values that do not fit are refused with the value" do
    for {bad, values} <- [{2.5, [1, 2.5]}, {nil, [nil]}, {2 ** 63, [1, 2 ** 63]}, {1, [true, 1]}] do
      times = Enum.to_list(1..length(values))
      error = catch_error(Columns.new(times, values))
      assert %Error{code: :not_columns} = error
      assert Exception.message(error) =~ inspect(bad)
      assert Columns.from_messages(messages(values)) == :error
    end
  end

  test "times of more than 64 bits are refused" do
    assert %Error{code: :not_columns} = catch_error(Columns.new([1, 2 ** 63], [1, 2]))
  end

  test "replaced values are as many, and finite" do
    columns = Columns.new([1, 2], [1.5, 2.5])
    assert Columns.values(Columns.put_values(columns, [3, 4])) == [3, 4]
    assert Columns.values(Columns.put_values(columns, <<1, 0>>, :boolean)) == [true, false]
    infinite = <<0, 0, 0, 0, 0, 0, 0xF0, 0x7F>>
    nan = <<1, 0, 0, 0, 0, 0, 0xF8, 0xFF>>

    for values <- [[1], [], <<0::64>>, <<1.5::float-little-64>> <> infinite, nan <> <<0::64>>],
        do: assert(%Error{code: :not_columns} = catch_error(Columns.put_values(columns, values)))

    assert %Error{} = catch_error(Columns.put_values(columns, <<1, 2>>, :boolean))
    assert %Error{} = catch_error(Columns.put_values(columns, [1, 2.5]))
  end
end
