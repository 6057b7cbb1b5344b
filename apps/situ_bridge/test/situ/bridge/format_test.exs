defmodule Situ.Bridge.FormatTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Format
  alias Situ.Test.Budget
  alias Situ.Bridge.Format.{Csv, TimeFormat}
  doctest Format
  doctest TimeFormat
  doctest Format.Value
  doctest Csv
  doctest Csv.Number

  # 1971-11-03T00:00:00.1234567Z
  @time 57_974_400_123_456_700

  defp value, do: resize(value(2), 6)
  defp value(0), do: one_of([integer(), float(), boolean(), ascii_text(), constant(nil)])

  defp value(n) do
    members = map(list(pair({:proper_types.non_empty(ascii_text()), value(n - 1)})), &Map.new/1)
    frequency([{3, value(0)}, {1, list(value(n - 1))}, {1, members}])
  end

  defp pair({a, b}), do: :proper_types.tuple([a, b])

  for format <- [:json, :json_lines, :message_pack, :situ] do
    property "#{format} decodes the encoded value and time" do
      forall {value, time} <-
               pair({value(), integer(-10_000_000_000_000_000_000, 10_000_000_000_000_000_000)}) do
        {:ok, bytes} = Format.encode(unquote(format), value, time)
        assert Format.decode(unquote(format), bytes) == {:ok, {time, value}}
      end
    end
  end

  defp column(:integer, values), do: for(n <- values, into: <<>>, do: <<n::little-64>>)
  defp column(:float, values), do: for(x <- values, into: <<>>, do: <<x::little-float-64>>)
  defp column(:boolean, values), do: for(b <- values, into: <<>>, do: <<if(b, do: 1, else: 0)>>)

  # Returns floats of every magnitude: any bits that are a number.
  defp any_float do
    map(integer(0, 2 ** 64 - 1), fn bits ->
      case <<bits::64>> do
        <<x::float-64>> -> x
        _ -> bits / 1
      end
    end)
  end

  property "writes columns of numbers and single numbers the same way", numtests: 300 do
    plain =
      one_of([
        pair({constant(:integer), nonempty_list(integer(-(2 ** 63), 2 ** 63 - 1))}),
        pair({constant(:integer), nonempty_list(integer())}),
        pair({constant(:float), nonempty_list(float())}),
        pair({constant(:float), nonempty_list(any_float())}),
        pair({constant(:boolean), nonempty_list(boolean())})
      ])

    forall {{kind, values}, first, format, n} <-
             {plain, integer(-(2 ** 62), 2 ** 62), one_of([:csv, :json_lines, :message_pack]),
              integer(0, 2)} do
      times = for i <- 1..length(values)//1, do: first + i * 33_333_300
      messages = for {value, time} <- Enum.zip(values, times), do: message(value, time)

      columns = %Situ.Columns{
        kind: kind,
        count: length(values),
        times: column(:integer, times),
        creation_times: column(:integer, times),
        values: column(kind, values)
      }

      {many, n1} = Format.encode_records(format, columns, n)
      {single, n2} = Format.encode_records(format, messages, n)
      assert {IO.iodata_to_binary(many), n1} == {IO.iodata_to_binary(single), n2}
    end
  end

  defp message(value, time),
    do: %Situ.Message{data: value, originating_time: time, creation_time: time, sequence_id: 1}

  describe "CSV records" do
    defp csv(values) do
      messages = for {value, i} <- Enum.with_index(values), do: message(value, i * 100)
      {records, {n, _names}} = Format.encode_records(:csv, messages, 0)
      assert n == length(values)

      records
      |> IO.iodata_to_binary()
      |> String.split("\r\n", trim: true)
      |> Enum.map(&String.slice(&1, 29..-1//1))
    end

    test "have the columns of the header, whatever members they have" do
      assert [_, "1,2", ",3", "4,", ","] = csv([%{a: 1, b: 2}, %{b: 3}, %{a: 4, b: nil}, %{}])
      assert [_, "1,2", "3,"] = csv([[1.0, 2.0], [3.0]])
      # Names may occur twice.
      twice = {[{"x", 1}, {"in", {[{"x", 2}]}}]}
      assert [_, "1,2", "1,2"] = csv([twice, twice])
    end

    test "are rejected, not shifted, if a member is not in the header" do
      for values <- [[%{a: 1}, %{b: 2}], [%{a: 1}, 5], [nil, %{a: 1}], [[1.0], [1.0, 2.0]]] do
        error = assert_raise Situ.Error, fn -> csv(values) end
        assert error.code == :not_writable and error.why =~ "no column"
      end

      assert [_, "1", "", ""] = csv([1, nil, %{a: nil}])
    end
  end

  property "CSV decodes flat records of strings and numbers, and their time" do
    forall {fields, time} <-
             pair(
               {nonempty_list(pair({ascii_text(), one_of([integer(), boolean(), ascii_text()])})),
                integer()}
             ) do
      fields =
        for {{name, value}, i} <- Enum.with_index(fields), do: {"#{i}#{name}", text_or(value)}

      {:ok, bytes} = Format.encode(:csv, {fields}, time)
      assert Format.decode(:csv, bytes, objects: :pairs) == {:ok, {time, {fields}}}
    end
  end

  # A string that looks like another value is decoded as that value.
  defp text_or(value) when is_binary(value), do: "t" <> value
  defp text_or(value), do: value

  property "CSV keeps the exact value of floats" do
    forall x <- float() do
      assert Csv.Number.parse_field(Csv.Number.encode_number(x)) == x
    end
  end

  test "encodes structs as objects in the order of their fields" do
    assert Format.encode(:csv, %Situ.Point3{x: 1.0, y: 2.5, z: -1.0}, @time) ==
             {:ok, "_OriginatingTime_,x,y,z\r\n1971-11-03T00:00:00.1234567Z,1,2.5,-1\r\n"}
  end

  test "returns an error for values that cannot be written" do
    for format <- Format.format_names() do
      assert {:error, %{code: :not_writable}} = Format.encode(format, %{a: self()}, 0)
      assert {:error, %{code: :bad_message}} = Format.decode(format, "nonsense \xFF")
      assert {:error, %{code: :bad_message}} = Format.decode(format, "")
    end
  end

  describe "files" do
    # The records are the same wherever the bytes are split.
    for format <- [:json, :json_lines, :csv, :message_pack] do
      property "of #{format} are decoded from chunks of any size" do
        forall {values, sizes} <-
                 pair({list(pair({ascii_text(), integer()})), nonempty_list(integer(1, 50))}) do
          module = Format.fetch_module!(unquote(format))

          timed =
            for {{text, n}, i} <- Enum.with_index(values),
                do: {i, %{"n" => n, "text" => "x" <> text}}

          records =
            for {{time, value}, i} <- Enum.with_index(timed), do: module.record(value, time, i)

          bytes = IO.iodata_to_binary([records, module.finish(length(records))])
          assert pieces(module, bytes, sizes, module.start(), "") == timed
        end
      end

      test "of #{format} that are truncated yield their complete records" do
        module = Format.fetch_module!(unquote(format))
        records = for i <- 0..4, do: module.record(%{"n" => i}, i, i) |> IO.iodata_to_binary()
        bytes = Enum.join(records)

        for size <- 0..(byte_size(bytes) - 1) do
          case module.split(binary_part(bytes, 0, size), module.start(), true, []) do
            # A last CSV record needs no line break, so digits may be missing.
            {:ok, found, _} ->
              whole = if unquote(format) == :csv, do: Enum.drop(found, -1), else: found
              assert whole == Enum.take(for(i <- 0..4, do: {i, %{"n" => i}}), length(whole))

            {:error, why} ->
              assert is_binary(why)
          end
        end
      end
    end
  end

  defp pieces(module, bytes, [size | sizes], state, rest) do
    size = min(size, byte_size(bytes))
    <<piece::binary-size(size), bytes::binary>> = bytes
    {:ok, found, {rest, state}} = module.split(rest <> piece, state, bytes == "", [])

    if bytes == "",
      do: found,
      else: found ++ pieces(module, bytes, sizes ++ [size + 1], state, rest)
  end

  @tag timeout: 300_000
  test "decodes mutated bytes to values or errors" do
    value = %{"a" => [1, 2.5, nil, "x,\"y\""], "b" => %{"c" => -3}}

    for format <- Format.format_names() do
      module = Format.fetch_module!(format)

      bytes =
        IO.iodata_to_binary([
          module.record(value, 12_345, 0),
          module.record(value, 99_999, 1),
          module.finish(2)
        ])

      for _ <- 1..Budget.mutation_count(2_000) do
        case module.split(mutate(bytes), module.start(), true, []) do
          {:ok, found, _} -> assert is_list(found)
          {:error, why} -> assert is_binary(why)
        end
      end
    end
  end

  defp mutate(bytes) do
    at = :rand.uniform(byte_size(bytes)) - 1
    <<before::binary-size(at), c, rest::binary>> = bytes

    case :rand.uniform(4) do
      1 -> before
      2 -> before <> rest
      3 -> before <> <<:rand.uniform(256) - 1>> <> rest
      4 -> before <> <<c, Enum.random('{}[]",:\\\r\n'), c>> <> rest
    end
  end

  test ":situ keeps images and terms, and rejects hostile bytes" do
    image = Situ.Image.new!(width: 2, height: 1, format: :gray8, data: <<1, 2>>)
    {:ok, bytes} = Format.encode(:situ, image, 5)
    assert {:ok, {5, ^image}} = Format.decode(:situ, bytes)
    {:ok, bytes} = Format.encode(:situ, %{x: {1, nil, 3 ** 80}}, -5)
    assert {:ok, {-5, %{x: {1, nil, big}}}} = Format.decode(:situ, bytes)
    assert big == 3 ** 80
    assert {:error, %{code: :not_writable}} = Format.encode(:situ, self(), 0)
    call = :erlang.term_to_binary(&File.rm/1)
    assert {:error, %{code: :bad_message}} = Format.decode(:situ, <<0::64, 0, call::binary>>)
    assert {:error, _} = Format.decode(:situ, <<0::64, 3, "abc", 1>>)
    assert {:error, _} = Format.decode(:situ, <<0::64, 30, "abc">>)
  end
end
