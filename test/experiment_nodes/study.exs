# Makes a dataset of six sessions in a folder: `study.exs FOLDER`. Each has a noisy level and the truth.
{:ok, _} = Application.ensure_all_started(:situ_dataset)
alias Situ.Dataset.{Partition, Session}
alias Situ.Store.Writer

[folder] = System.argv()
step = Situ.Time.ms(50)

record = fn root, name, stream, values ->
  {:ok, writer} = Writer.create(name, root)
  {:ok, open} = Writer.stream(writer, stream)

  messages =
    for {{time, value}, n} <- Enum.with_index(values, 1),
        do: %Situ.Message{
          data: value,
          originating_time: time,
          creation_time: time,
          sequence_id: n
        }

  {:ok, open} = Writer.append(open, messages)
  {last, _} = List.last(values)
  {:ok, _} = Writer.close_stream(open, last)
  :ok = Writer.close(writer)
  writer.path
end

{:ok, dataset} = Situ.Dataset.new("Study", file: Path.join(folder, "study.json"))

dataset =
  for i <- 1..6, reduce: dataset do
    dataset ->
      root = Path.join(folder, "p#{i}")
      times = for k <- 0..199, do: {k, i * 1_000_000_000_000 + k * step}
      speaks? = &(&1 in 40..79 or &1 in 120..149)
      noise = fn k -> 0.06 * i * :math.sin(k * 12.9898 + i * 78.233) end
      level = for {k, t} <- times, do: {t, if(speaks?.(k), do: 0.6, else: 0.2) + noise.(k)}
      truth = for {k, t} <- times, do: {t, speaks?.(k)}
      room = Partition.new("Room", record.(root, "room", "Level", level))
      truth = Partition.new("Truth", record.(root, "truth", "Speaking.Truth", truth))
      {:ok, session} = Session.add_partition(Session.new("p#{i}"), room)
      {:ok, session} = Session.add_partition(session, truth)
      {:ok, dataset} = Situ.Dataset.add_session(dataset, session)
      dataset
  end

{:ok, _} = Situ.Dataset.save(dataset)
