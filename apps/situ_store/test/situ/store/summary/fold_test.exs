defmodule Situ.Store.Summary.FoldTest do
  # Compares the native summary with the reference.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store
  alias Situ.Store.Summary.Fold
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  @values [true, false, nil, :idle, :busy, "ann", "bob", 1, -2.5, 7_000_000_000, {1, 2}, [3]]

  defp data(n) when n < 60, do: Enum.at(@values, rem(n, length(@values)))

  defp data(n) do
    for {key, at} <- Enum.with_index([:x, :who, "text key", 5]), rem(n, at + 2) != 0, into: %{} do
      {key, data(rem(n * (at + 1), 60))}
    end
  end

  defp write(root, steps, kind, opts) do
    {:ok, writer} = Writer.create("fold", root, first_extent: 65_536)
    {:ok, stream} = Writer.stream(writer, "S", opts)

    {_, messages} =
      Enum.reduce(steps, {0, []}, fn {step, n}, {time, messages} ->
        time = time + step
        data = if kind == :states, do: rem(n, 3) == 0, else: data(n)
        {time, [Store.Test.Record.message(data, time) | messages]}
      end)

    messages
    |> Enum.reverse()
    |> Enum.chunk_every(37)
    |> Enum.reduce(stream, fn batch, stream ->
      {:ok, stream} = Writer.append(stream, batch)
      stream
    end)

    writer
  end

  defp agrees?(store, from, to, level, most) do
    {:ok, info} = Store.stream_info(store, "S")
    {:ok, counts, tracks} = Fold.fold_tracks(store, info, from, to, level, most)
    told = store.module.tracks(store.state, info, from, to, level, most)
    {:ok, native_counts, native_tracks} = told

    (counts == native_counts and
       Enum.sort(tracks) == Enum.sort(native_tracks)) or
      flunk("#{inspect({from, to, level, most})}\n#{inspect(tracks)}\n#{inspect(native_tracks)}")
  end

  property "the native summary matches the reference that reads every message", context: context do
    forall {steps, kind, spans, closed?} <-
             {nonempty_list({integer(1, 3_000), integer(0, 200)}), one_of([:states, :mixed]),
              list({integer(0, 200_000), integer(0, 200_000), integer(0, 16), integer(0, 12)}, 4),
              boolean()} do
      root = Path.join(context.tmp_dir, "#{System.unique_integer([:positive])}")
      # This is enough for stored bins.
      steps = steps |> Stream.cycle() |> Enum.take(if closed?, do: 900, else: 400)
      writer = write(root, steps, kind, [])
      if closed?, do: :ok = Writer.close(writer)
      store = Store.open!(writer.path)

      result =
        Enum.all?(spans, fn {a, b, level, most} ->
          agrees?(store, min(a, b), max(a, b), level, most)
        end)

      _ = Writer.close(writer)
      File.rm_rf!(root)
      result
    end
  end
end
