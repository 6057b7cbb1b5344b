defmodule Situ.Studio.Recordings.Session do
  @moduledoc false
  # Combines the recordings of a dataset's session on one time axis. If there are several
  # partitions, the names of their streams begin with the partition's name (`Room.Video`).
  @behaviour Situ.Recording

  alias Situ.{Error, Recording, Store}
  alias Situ.Studio.{Recordings, StreamReader}
  alias Situ.Studio.Recordings.Origin

  @enforce_keys [:parts]
  defstruct [:parts, broken: []]

  @typedoc "`parts` are the opened recordings with the prefixes of their streams."
  @type t :: %__MODULE__{parts: [{prefix :: String.t(), Recording.t()}], broken: [String.t()]}

  @doc """
  Opens the recordings `[{partition, path}]` as far as possible. Returns the first error if none
  can be opened.

      iex> {:error, error} = Situ.Studio.Recordings.Session.open([{"Room", "/nowhere/room.0000"}])
      iex> error.code
      :no_store
  """
  @spec open([{String.t(), Path.t()}]) :: {:ok, Recording.t()} | {:error, Error.t()}
  def open(paths) do
    opened = for {name, path} <- paths, do: {name, Recordings.Store.open(path)}
    parts = for {name, {:ok, recording}} <- opened, do: {stream_prefix(name, paths), recording}
    broken = for {name, {:error, error}} <- opened, do: {name, error}

    case {parts, broken} do
      {[], [{_, error} | _]} -> {:error, error}
      {[], []} -> {:error, Error.new(:empty, "the session has no recordings")}
      _ -> {:ok, %Recording{module: __MODULE__, state: build_session(parts, broken)}}
    end
  end

  @doc "Combines open recordings `[{prefix, recording}]`; the names of the streams begin with the prefixes."
  @spec combine([{prefix :: String.t(), Recording.t()}]) :: Recording.t()
  def combine([{_, first} | _] = parts),
    do: %Recording{path: first.path, module: __MODULE__, state: build_session(parts, [])}

  defp build_session(parts, broken) do
    broken = for {name, error} <- broken, do: "#{name} cannot be opened: #{error.what}"
    %__MODULE__{parts: parts, broken: broken}
  end

  defp stream_prefix(_name, [_one]), do: ""
  defp stream_prefix(name, _several), do: name <> "."

  @impl true
  def info(%{parts: parts, broken: broken}) do
    infos = for {_, recording} <- parts, do: Store.info(recording)

    damage =
      for {prefix, recording} <- parts,
          what <- StreamReader.list_damage(recording),
          do: String.trim_leading("#{prefix} #{what}")

    %{
      name: nil,
      created: nil,
      closed?: Enum.all?(infos, & &1.closed?),
      live?: Enum.any?(infos, & &1.live?),
      damage: broken ++ damage
    }
  end

  @impl true
  def streams(%{parts: parts}) do
    for {prefix, recording} <- parts,
        info <- Store.streams(recording),
        do: add_prefix(info, prefix, recording)
  end

  defp add_prefix(info, prefix, recording),
    do: %{Origin.put_origin(info, recording) | name: prefix <> info.name}

  # Names of partitions and streams may contain dots. The first part that contains the rest of the name is used, longest
  # prefix first.
  @impl true
  def stream(%{parts: parts}, name) do
    parts
    |> Enum.filter(fn {prefix, _} -> String.starts_with?(name, prefix) end)
    |> Enum.sort_by(fn {prefix, _} -> -byte_size(prefix) end)
    |> Enum.reduce_while(unknown_stream_error(name), fn {prefix, recording}, missing ->
      case Store.stream_info(recording, String.replace_prefix(name, prefix, "")) do
        {:ok, info} -> {:halt, {:ok, add_prefix(info, prefix, recording)}}
        {:error, %Error{code: :no_stream}} -> {:cont, missing}
        error -> {:halt, error}
      end
    end)
  end

  defp unknown_stream_error(name),
    do: {:error, Error.new(:no_stream, "unknown stream #{inspect(name)}")}

  @impl true
  def seek(_session, info, time), do: Origin.seek(info, time)

  @impl true
  def read(_session, info, ordinal, to, limit, opts),
    do: Origin.read(info, ordinal, to, limit, opts)

  @impl true
  def summary(_session, info, from, to, pixels), do: Origin.summary(info, from, to, pixels)

  @impl true
  def tracks(_session, info, from, to, level, most),
    do: Origin.tracks(info, from, to, level, most)
end
