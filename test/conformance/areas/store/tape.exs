defmodule Situ.Conformance.Store.Tape do
  # Shared functions for store cases, which record and replay the streams of a case.
  import Situ.Conformance.Case, only: [meant: 3, verdict: 2]
  alias Situ.{Message, Pipeline, Store}

  @ms 1_000_000

  # What a case says of messages that are those of the original.
  @unchanged ~r/same|unchanged|identical|equal|kept|keep|preserved/

  def ms, do: @ms

  def streams(case) do
    for input <- case["inputs"] || [] do
      messages =
        for {m, i} <- Enum.with_index(input["messages"] || [], 1) do
          %Message{
            data: m["v"],
            originating_time: Situ.Conformance.Case.time(m),
            creation_time: Situ.Conformance.Case.time(m) + 5,
            sequence_id: i
          }
        end

      {input["stream"], messages}
    end
  end

  def source(p, messages),
    do: Situ.from_enumerable(p, for(m <- messages, do: {m.originating_time, m.data}))

  # A pipeline records them as fast as possible. Sequence ids count from 1, and creation times
  # come from its clock.
  def record(root, streams, options \\ fn _ -> [] end, name \\ "store") do
    result =
      Pipeline.run(fn p ->
        exporter = Store.create(p, name, root)

        for {stream, messages} <- streams do
          p |> source(messages) |> Store.write(exporter, stream, options.(stream))
        end

        exporter.path
      end)

    case result do
      {:ok, report} -> report.result
      {:error, error} -> raise error
    end
  end

  def replay(path, name, interval \\ {:unbounded, :unbounded}, options \\ []) do
    test = self()

    result =
      Pipeline.run(
        fn p -> p |> Store.importer(path) |> Store.stream(name, options) |> tell(test) end,
        pipeline: [replay: [interval: interval, speed: :max]]
      )

    case result do
      {:ok, _} -> told()
      {:error, error} -> raise error
    end
  end

  def tell(stream, {pid, tag}),
    do: Situ.each(stream, fn _, message -> send(pid, {:told, {tag, message}}) end)

  def tell(stream, pid), do: Situ.each(stream, fn _, message -> send(pid, {:told, message}) end)

  def told(got \\ []) do
    receive do
      {:told, message} -> told([message | got])
    after
      0 -> Enum.reverse(got)
    end
  end

  def until(fun, left \\ 500) do
    cond do
      fun.() -> :ok
      left == 0 -> raise "waited in vain"
      true -> Process.sleep(10) && until(fun, left - 1)
    end
  end

  def envelopes(messages),
    do: for(m <- messages, do: {m.originating_time, m.sequence_id, m.data})

  def times(messages), do: Enum.map(messages, & &1.originating_time)
  def data(store, name), do: Enum.map(Store.messages(store, name), & &1.data)

  # A parameter that is a time, in any unit: "from_ms", "from_ticks" ...
  defdelegate time(params, name), to: Situ.Conformance.Text, as: :duration

  # `{from, to}`, or `nil` if the case specifies none.
  def bounds(params), do: {time(params, "from"), time(params, "to")}

  # Compares the store with the case's expected streams, counts and metadata. `kept?` returns
  # whether a stream (or :all) has the messages of the original store.
  def by_stream(case, store, kept? \\ nil) do
    expect = case["expect"] || %{}

    verdict(
      expect,
      Map.new(expect, fn {key, wanted} -> {key, part(key, wanted, store, kept?)} end)
    )
  end

  defp part(key, wanted, store, kept?) do
    cond do
      Store.has_stream?(store, key) and is_list(wanted) ->
        data(store, key)

      key =~ ~r/^sums?$/ ->
        Enum.sum(all_data(store))

      key in ["count", "messages", "message_count"] ->
        length(all_data(store))

      key in ["available_streams", "streams"] and is_integer(wanted) ->
        length(Store.streams(store))

      key == "supplemental_metadata" ->
        metadata(store)

      kept? ->
        unchanged(wanted, kept?.(original(key, store)))

      true ->
        {:unread, wanted}
    end
  end

  defp unchanged(wanted, kept?) when is_boolean(wanted), do: kept?
  defp unchanged(wanted, kept?), do: meant(wanted, @unchanged, kept?)

  # "stream0", "stream0_envelopes" and "envelopes_of_stream0" are about that stream.
  defp original(key, store) do
    names = Enum.map(Store.streams(store), & &1.name)
    Enum.find(names, :all, &(key == &1 or key =~ ~r/^#{&1}_|_(of_)?#{&1}$/))
  end

  defp all_data(store), do: Enum.flat_map(Store.streams(store), &data(store, &1))

  defp metadata(store) do
    Enum.find_value(Store.streams(store), fn info ->
      case Store.metadata(store, info.name) do
        {:ok, term} -> term
        {:error, _} -> nil
      end
    end)
  end
end
