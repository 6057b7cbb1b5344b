defmodule Situ.Dataset.Test.Study do
  @moduledoc false
  # Creates small recordings and datasets.
  alias Situ.{Message, Store}
  alias Situ.Dataset.{Partition, Session}

  @s 1_000_000_000

  @doc "Writes `root/name.NNNN` from `%{\"Name\" => [{time, value}]}`, and returns its folder."
  def record(root, name, streams) do
    {:ok, writer} = Store.Writer.create(name, root)

    for {stream, items} <- Enum.sort(streams) do
      {:ok, stream} = Store.Writer.stream(writer, stream, type: type(items))

      messages =
        for {{time, value}, n} <- Enum.with_index(items, 1),
            do: %Message{
              data: value,
              originating_time: time,
              creation_time: time + 1_000,
              sequence_id: n
            }

      {:ok, stream} = Store.Writer.append(stream, messages)
      {last, _} = List.last(items)
      {:ok, _} = Store.Writer.close_stream(stream, last)
    end

    :ok = Store.Writer.close(writer)
    writer.path
  end

  defp type([{_, value} | _]) when is_integer(value), do: :integer
  defp type([{_, value} | _]) when is_float(value), do: :float
  defp type([{_, value} | _]) when is_boolean(value), do: :boolean
  defp type(_), do: :any

  @doc "Returns the integers 0..9, one second apart, starting at `start` seconds."
  def ten(start), do: for(i <- 0..9, do: {(start + i) * @s, i})

  @doc """
  Creates `n` sessions p1..pn, each with a partition Room.
  The stream Level of session pN starts at N * 100 s.
  """
  def dataset(root, n) do
    {:ok, dataset} = Situ.Dataset.new("Study", file: Path.join(root, "study.json"))

    Enum.reduce(1..n, dataset, fn i, dataset ->
      path = record(Path.join(root, "p#{i}"), "room", %{"Level" => ten(i * 100)})
      {:ok, session} = Session.add_partition(Session.new("p#{i}"), Partition.new("Room", path))
      {:ok, dataset} = Situ.Dataset.add_session(dataset, session)
      dataset
    end)
  end
end
