defmodule Situ.Studio.Source.Session do
  @moduledoc """
  Provides a session of a dataset as a source, with all its recordings on one time axis. If there are several
  partitions, the names of their streams begin with the partition's name (`Room.Video`).

      iex> {:error, error} = Situ.Studio.Source.Session.open([{"Room", "/nowhere/room.0000"}])
      iex> error.code
      :no_store
  """
  @behaviour Situ.Studio.Source

  alias Situ.Error
  alias Situ.Studio.Source

  @enforce_keys [:paths, :parts]
  defstruct [:paths, :parts, broken: []]

  @typedoc "`paths` are the requested recordings, and `parts` the opened ones with the prefixes of their streams."
  @type t :: %__MODULE__{
          paths: [{String.t(), Path.t()}],
          parts: [{prefix :: String.t(), Source.t()}],
          broken: [String.t()]
        }

  @doc "Opens the recordings `[{partition, path}]` as far as possible. Returns the first error if none can be opened."
  @spec open([{String.t(), Path.t()}]) :: {:ok, Source.t()} | {:error, Error.t()}
  def open(paths) do
    opened = for {name, path} <- paths, do: {name, Source.Store.open(path)}
    parts = for {name, {:ok, source}} <- opened, do: {stream_prefix(name, paths), source}
    broken = for {name, {:error, error}} <- opened, do: {name, error}

    case {parts, broken} do
      {[], [{_, error} | _]} -> {:error, error}
      {[], []} -> {:error, Error.new(:empty, "the session has no recordings")}
      _ -> {:ok, {__MODULE__, build_session(paths, parts, broken)}}
    end
  end

  defp build_session(paths, parts, broken) do
    broken = for {name, error} <- broken, do: "#{name} cannot be opened: #{error.what}"
    %__MODULE__{paths: paths, parts: parts, broken: broken}
  end

  defp stream_prefix(_name, [_one]), do: ""
  defp stream_prefix(name, _several), do: name <> "."

  @impl true
  def extent(%__MODULE__{parts: parts}) do
    extents = for {_, source} <- parts, do: Source.call(source, :extent, [])

    case Enum.find(extents, &match?({:error, _}, &1)) do
      nil -> {:ok, merge_extents(Enum.map(extents, &elem(&1, 1)))}
      error -> error
    end
  end

  # The extents of recordings without messages are meaningless.
  defp merge_extents(extents) do
    timed = Enum.reject(extents, &(&1.from == &1.to and &1.from == 0))
    timed = if timed == [], do: extents, else: timed

    %{
      from: timed |> Enum.map(& &1.from) |> Enum.min(),
      to: timed |> Enum.map(& &1.to) |> Enum.max(),
      live: Enum.any?(extents, & &1.live),
      version: extents |> Enum.map(& &1.version) |> Enum.sum()
    }
  end

  @impl true
  def streams(%__MODULE__{parts: parts}) do
    named =
      for {prefix, source} <- parts,
          {:ok, infos} <- [Source.call(source, :streams, [])],
          info <- infos,
          do: %{info | name: prefix <> info.name}

    {:ok, Enum.sort_by(named, & &1.name)}
  end

  @impl true
  def damage(%__MODULE__{parts: parts, broken: broken}) do
    broken ++
      for(
        {prefix, source} <- parts,
        what <- Source.list_damage(source),
        do: prefix <> " " <> what
      )
  end

  @impl true
  def series(session, stream, from, to, bin),
    do: with_stream(session, stream, &Source.call(&1, :series, [&2, from, to, bin]))

  @impl true
  def messages(session, stream, from, to, limit),
    do: with_stream(session, stream, &Source.call(&1, :messages, [&2, from, to, limit]))

  @impl true
  def marks(session, stream, from, to, limit),
    do: with_stream(session, stream, &Source.call(&1, :marks, [&2, from, to, limit]))

  @impl true
  def sample(session, stream, from, to, n),
    do: with_stream(session, stream, &Source.sample_messages(&1, &2, from, to, n))

  @impl true
  def summary(session, stream, from, to, bins),
    do: with_stream(session, stream, &Source.fetch_summary(&1, &2, from, to, bins))

  @impl true
  def latest_at(session, stream, time),
    do: with_stream(session, stream, &Source.call(&1, :latest_at, [&2, time]))

  @impl true
  def next_after(session, stream, time),
    do: with_stream(session, stream, &Source.call(&1, :next_after, [&2, time]))

  # Names of partitions and streams may contain dots. The first part that contains the rest of the name is used, longest
  # prefix first.
  defp with_stream(%__MODULE__{parts: parts}, stream, fun) do
    parts
    |> Enum.filter(fn {prefix, _} -> String.starts_with?(stream, prefix) end)
    |> Enum.sort_by(fn {prefix, _} -> -byte_size(prefix) end)
    |> Enum.reduce_while(unknown_stream_error(stream), fn {prefix, source}, missing ->
      case fun.(
             source,
             binary_part(stream, byte_size(prefix), byte_size(stream) - byte_size(prefix))
           ) do
        {:error, %Error{code: :no_stream}} -> {:cont, missing}
        answer -> {:halt, answer}
      end
    end)
  end

  defp unknown_stream_error(stream),
    do: {:error, Error.new(:no_stream, "unknown stream #{inspect(stream)}")}
end
