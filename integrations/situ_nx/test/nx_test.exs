defmodule Situ.NxTest do
  use ExUnit.Case, async: true
  doctest Situ.Nx

  alias Situ.{AudioBuffer, AudioFormat, Columns, DepthImage, Image, Tensor}

  defmodule Numeric do
    import Nx.Defn

    defn(square(x), do: x * x)
    defn(sum_rows(x), do: Nx.sum(x, axes: [1]))
    defn(both(x), do: {x + 1, %{double: x * 2}})
  end

  describe "to_nx/1 and from_nx/2" do
    test "keep shapes and types, and convert back" do
      bytes = :crypto.strong_rand_bytes(4 * 3 * 2)
      image = Image.new!(width: 4, height: 2, format: :rgb24, data: bytes)
      audio = %AudioBuffer{format: AudioFormat.pcm(16_000, 2), data: bytes}

      for {value, shape, type} <- [
            {Tensor.new(bytes, :s16, {3, 4}), {3, 4}, {:s, 16}},
            {image, {2, 4, 3}, {:u, 8}},
            {audio, {6, 2}, {:s, 16}},
            {Columns.new([1, 2, 3], [4, 5, 6]), {3}, {:s, 64}}
          ] do
        nx = Situ.Nx.to_nx(value)
        assert {Nx.shape(nx), Nx.type(nx)} == {shape, type}
        assert Situ.Nx.from_nx(nx, value) == value
      end

      nx = Situ.Nx.to_nx(image)
      assert %Tensor{type: :u8, shape: {2, 4, 3}, data: ^bytes} = Situ.Nx.from_nx(nx)
    end

    test "share the bytes" do
      size = 64_000_000
      bytes = :binary.copy(<<7>>, size)
      image = Image.new!(width: 4_000, height: div(size, 16_000), format: :bgra32, data: bytes)
      audio = %AudioBuffer{format: AudioFormat.pcm(16_000, 2), data: bytes}

      for value <- [Tensor.new(bytes, :u8, {size}), image, audio] do
        before = :erlang.memory(:binary)
        nx = Situ.Nx.to_nx(value)
        back = Situ.Nx.from_nx(nx, value)
        assert :erlang.memory(:binary) - before < div(size, 4)
        assert back.data == bytes
      end
    end

    test "leave out the padding of rows" do
      image =
        Image.new!(
          width: 2,
          height: 2,
          format: :gray8,
          stride: 4,
          data: <<1, 2, 0, 0, 3, 4, 0, 0>>
        )

      assert Nx.to_list(Situ.Nx.to_nx(image)) == [[1, 2], [3, 4]]

      assert %Image{stride: 2, data: <<2, 4, 6, 8>>} =
               image
               |> Situ.Nx.to_nx()
               |> Nx.multiply(2)
               |> Nx.as_type(:u8)
               |> Situ.Nx.from_nx(image)

      depth = %DepthImage{
        width: 1,
        height: 2,
        stride: 4,
        data: <<1::16-little, 0::16, 2::16-little, 0::16>>
      }

      assert Nx.to_list(Situ.Nx.to_nx(depth)) == [[1], [2]]
    end

    test "16-bit images and 24-bit samples have their values" do
      image = Image.new!(width: 1, height: 1, format: :gray16, data: <<1_000::16-little>>)
      assert Situ.Nx.to_nx(image) == Nx.tensor([[1_000]], type: :u16)
      audio = %AudioBuffer{format: AudioFormat.pcm(8_000, 1, :s24), data: <<-5::24-little>>}
      assert Nx.to_flat_list(Situ.Nx.to_nx(audio)) == [-5]
    end

    test "explain a type without a tensor, and a tensor that does not fit" do
      assert %Situ.Error{code: :no_tensor} = catch_error(Situ.Nx.to_nx("text"))
      image = Image.new_filled(2, 2, :gray8)
      error = catch_error(Situ.Nx.from_nx(Nx.tensor([1.0]), image))
      assert error.code == :bad_tensor
      assert error.why =~ "{2, 2}"
    end

    test "columns of several pages become one tensor" do
      pages = [Columns.new([1, 2], [0.5, 1.5]), Columns.new([3], [2.5])]
      {times, values} = Situ.Nx.join_columns(pages)
      assert {Nx.to_list(times), Nx.to_list(values)} == {[1, 2, 3], [0.5, 1.5, 2.5]}
    end
  end

  describe "map/3" do
    test "applies a defn to each message" do
      assert {:ok, results} =
               Situ.Test.run(
                 [n: [{0, 2}, {5, 3}]],
                 &Situ.Nx.map(&1.n, fn x -> Numeric.square(x) end)
               )

      assert [{0, four}, {5, nine}] = results
      assert {Nx.to_number(four), Nx.to_number(nine)} == {4, 9}
    end

    test "stacks the messages that are waiting, up to the size of a batch, with the same results" do
      me = self()
      inputs = for i <- 0..99, do: {i, [i, 2 * i]}

      fun = fn x ->
        send(me, {:shape, Nx.shape(x)})
        Numeric.sum_rows(x)
      end

      for pad <- [true, false] do
        assert {:ok, results} =
                 Situ.Test.run(
                   [n: inputs],
                   &Situ.Nx.map(&1.n, fun,
                     batch: 8,
                     pad: pad,
                     compiler: [compiler: Nx.Defn.Evaluator]
                   )
                 )

        assert Enum.map(results, fn {t, sum} -> {t, Nx.to_number(sum)} end) ==
                 for(i <- 0..99, do: {i, 3 * i})
      end

      # jit traces the function with each shape once or more.
      assert_received {:shape, {8, 2}}
    end

    test "results are tuples and maps of tensors, too" do
      assert {:ok, [{0, {one, %{double: zero}}}, _]} =
               Situ.Test.run(
                 [n: [{0, 0}, {1, 5}]],
                 &Situ.Nx.map(&1.n, fn x -> Numeric.both(x) end, batch: 4)
               )

      assert {Nx.to_number(one), Nx.to_number(zero)} == {1, 0}
    end

    test "runs a serving with its own conversion, and a running one by its name" do
      serving =
        Nx.Serving.new(fn opts -> Nx.Defn.jit(&Numeric.sum_rows/1, opts) end)
        |> Nx.Serving.client_preprocessing(fn
          lists when is_list(hd(lists)) -> {Nx.Batch.stack(Enum.map(lists, &Nx.tensor/1)), :many}
          list -> {Nx.Batch.stack([Nx.tensor(list)]), :one}
        end)
        |> Nx.Serving.client_postprocessing(fn
          output, _meta, :many -> Nx.to_list(output)
          output, _meta, :one -> output |> Nx.to_list() |> hd()
        end)

      inputs = for i <- 0..19, do: {i, [i, 1]}
      expected = for i <- 0..19, do: {i, i + 1}
      assert {:ok, ^expected} = Situ.Test.run([n: inputs], &Situ.Nx.map(&1.n, serving, batch: 4))

      start_supervised!(
        {Nx.Serving, serving: serving, name: __MODULE__.Shared, batch_size: 4, batch_timeout: 1}
      )

      assert {:ok, ^expected} = Situ.Test.run([n: inputs], &Situ.Nx.map(&1.n, __MODULE__.Shared))
    end

    test "a computation that fails is an error of the component, and skips one message" do
      assert {:error, %Situ.Error{code: :no_tensor}} =
               Situ.Test.run([n: [{0, "x"}]], &Situ.Nx.map(&1.n, fn x -> x end))

      assert {:ok, [{0, _}, {2, _}]} =
               Situ.Test.run(
                 [n: [{0, 1}, {1, "x"}, {2, 2}]],
                 &Situ.Nx.map(&1.n, fn x -> x end, batch: 3, on_error: :skip)
               )
    end
  end
end
