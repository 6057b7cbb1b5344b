defmodule Situ.Dataset.OpenSession do
  @moduledoc """
  Opens the recordings of a session, and finds the streams of all partitions by name.

      {:ok, dataset} = Situ.Dataset.open("study.json")
      {:ok, session} = Situ.Dataset.session(dataset, "p01")
      open = Situ.Dataset.OpenSession.open(session)
      {:ok, messages} = Situ.Dataset.OpenSession.messages(open, "Room.Loudness", from: t0)
      {:ok, messages} = Situ.Dataset.OpenSession.messages(open, "[Annotation]:Speaker")

  A stream's name suffices if only one partition has it; otherwise `"[Partition]:Stream"` selects the partition.
  Partitions that cannot be opened are listed in `troubles`; the others can be read.
  """
  alias Situ.Dataset.{NameRules, Partition, Session}
  alias Situ.{Error, Store}

  @enforce_keys [:session]
  defstruct [:session, stores: [], troubles: []]

  @type t :: %__MODULE__{
          session: Session.t(),
          stores: [{partition :: String.t(), Store.t()}],
          troubles: [{partition :: String.t(), Error.t()}]
        }

  @doc "Opens every partition that can be opened. Takes the options of `Situ.Store.open/2`."
  @spec open(Session.t(), keyword()) :: t()
  def open(%Session{} = session, opts \\ []) do
    Enum.reduce(Enum.reverse(session.partitions), %__MODULE__{session: session}, fn p, open ->
      case Partition.open(p, opts) do
        {:ok, store} -> %{open | stores: [{p.name, store} | open.stores]}
        {:error, error} -> %{open | troubles: [{p.name, error} | open.troubles]}
      end
    end)
  end

  @doc "Lists the streams of all partitions as `[{partition, Situ.Store.StreamInfo}]`."
  @spec list_streams(t()) :: [{String.t(), Store.StreamInfo.t()}]
  def list_streams(%__MODULE__{} = open) do
    for {partition, store} <- open.stores, info <- Store.streams(store), do: {partition, info}
  end

  @doc """
  Returns the shortest name that refers to this stream: its name, or `"[Partition]:Stream"` if several partitions
  have a stream of that name.
  """
  @spec shortest_address(t(), String.t(), String.t()) :: String.t()
  def shortest_address(%__MODULE__{} = open, partition, stream) do
    case fetch_stream(open, stream) do
      {:ok, {^partition, _, ^stream}} -> stream
      _ -> "[#{partition}]:#{stream}"
    end
  end

  @doc """
  Returns the partition, store and name of the stream that `spec` refers to.

  Errors: `:no_stream`, `:no_partition`, `:ambiguous_stream` (with the qualified names), or the error of opening the
  named partition.
  """
  @spec fetch_stream(t(), String.t()) ::
          {:ok, {partition :: String.t(), Store.t(), stream :: String.t()}} | {:error, Error.t()}
  def fetch_stream(%__MODULE__{} = open, spec) when is_binary(spec) do
    plain = for {p, store} <- open.stores, Store.has_stream?(store, spec), do: {p, store, spec}

    case {fetch_qualified(open, spec), plain} do
      {{:ok, match}, []} -> {:ok, match}
      {{:ok, match}, plain} -> {:error, ambiguous_error(spec, [match | plain])}
      {_, [match]} -> {:ok, match}
      {{:error, error}, []} -> {:error, error}
      {:none, []} -> {:error, no_stream_error(open, spec)}
      {_, several} -> {:error, ambiguous_error(spec, several)}
    end
  end

  @doc "Returns whether `spec` refers to exactly one stream."
  @spec has_stream?(t(), String.t()) :: boolean()
  def has_stream?(%__MODULE__{} = open, spec), do: match?({:ok, _}, fetch_stream(open, spec))

  @doc "Returns the messages of a stream as `{:ok, lazy_enumerable}`. Takes the options of `Situ.Store.messages/3`."
  @spec messages(t(), String.t(), keyword()) :: {:ok, Enumerable.t()} | {:error, Error.t()}
  def messages(%__MODULE__{} = open, spec, opts \\ []) do
    with {:ok, {_, store, stream}} <- fetch_stream(open, spec),
         do: {:ok, Store.messages(store, stream, opts)}
  end

  @doc "Returns the open store of a partition."
  @spec fetch_store(t(), String.t()) :: {:ok, Store.t()} | {:error, Error.t()}
  def fetch_store(%__MODULE__{} = open, partition) do
    stores = for {name, store} <- open.stores, do: %{name: name, store: store}

    case {Enum.find(open.troubles, &(elem(&1, 0) == partition)), open.session.name} do
      {{_, error}, _} ->
        {:error, error}

      {nil, name} ->
        owner = "session #{inspect(name)}"

        with {:ok, match} <-
               NameRules.fetch_named(stores, partition, :no_partition, "partition", owner),
             do: {:ok, match.store}
    end
  end

  defp fetch_qualified(open, spec) do
    with [_, partition, stream] <- Regex.run(~r/\A\[([^\]]+)\]:(.+)\z/s, spec),
         {:ok, store} <- fetch_store(open, partition),
         {:ok, _} <- Store.stream_info(store, stream) do
      {:ok, {partition, store, stream}}
    else
      nil -> :none
      {:error, error} -> {:error, error}
    end
  end

  defp ambiguous_error(spec, matches) do
    names = Enum.map_join(matches, ", ", fn {p, _, s} -> inspect("[#{p}]:#{s}") end)

    Error.new(
      :ambiguous_stream,
      "#{inspect(spec)} is ambiguous: it matches #{length(matches)} streams",
      why: "several partitions have a stream of that name",
      fix: "add the partition: #{names}"
    )
  end

  defp no_stream_error(open, spec) do
    names = for {_, info} <- list_streams(open), do: info.name

    why =
      case open.troubles do
        [] ->
          nil

        troubles ->
          "partitions that are not open: " <>
            Enum.map_join(troubles, "; ", fn {_, e} -> e.what end)
      end

    fix =
      case Situ.Options.nearest_name(spec, Enum.uniq(names)) do
        nil when names == [] ->
          nil

        nil ->
          "use one of #{names |> Enum.uniq() |> Enum.take(8) |> Enum.map_join(", ", &inspect/1)}"

        near ->
          "did you mean #{inspect(near)}?"
      end

    Error.new(
      :no_stream,
      "session #{inspect(open.session.name)} has no stream #{inspect(spec)}",
      why: why,
      fix: fix
    )
  end
end
