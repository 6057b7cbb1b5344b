defmodule Situ.Store.Pieces do
  @moduledoc false
  # A long recording in pieces: a store (the next version of its name) for each stretch of originating time, cut by
  # time or by size (`Situ.Store.Pieces.Cut`). One process hands the pieces to the components that write; it ends with
  # the pipeline. Every piece is a whole store, so what a kill or a power cut finds is what it would find of any.
  #
  # Streams do not run abreast: the piece before the newest stays open for those that are behind. A message later still
  # goes into the oldest open one. Pieces that `keep:` has no room for are deleted, the oldest first, and only those
  # made here.
  use GenServer
  alias Situ.Store.{Folder, Writer}
  alias Situ.Store.Pieces.Cut

  @type keep :: nil | {:span, Situ.Time.duration()} | {:bytes, pos_integer()}

  # By number: `open`, the pieces being written; `made`, the folders of the closed ones; of pieces cut by size `begun`,
  # the times at which they begin, and `ended`, those behind their latest messages.
  defstruct [
    :name,
    :root,
    :opts,
    :cut,
    :keep,
    :owner,
    open: %{},
    made: %{},
    begun: %{},
    ended: %{},
    streams: %{}
  ]

  @doc "Linked to the caller, and gone when it is."
  @spec start_link({String.t(), Path.t(), keyword()}, Cut.t(), keep()) :: GenServer.on_start()
  def start_link({name, root, opts}, cut, keep),
    do: GenServer.start_link(__MODULE__, {name, root, opts, cut, keep, self()})

  @doc "The stream `name` in the piece of this number, or in the oldest one that is open, and which that is."
  @spec stream(GenServer.server(), integer(), String.t(), keyword()) ::
          {:ok, integer(), Writer.Stream.t()} | {:error, Situ.Error.t()}
  def stream(pieces, number, name, opts),
    do: GenServer.call(pieces, {:stream, number, name, opts}, :timer.minutes(1))

  @doc "Messages up to `time` were appended to a piece: where that is cut by size, the next may have to begin."
  @spec appended(GenServer.server(), Cut.t(), integer(), Situ.Time.t()) :: :ok
  def appended(_pieces, %{newest: nil}, _number, _time), do: :ok
  def appended(pieces, _cut, number, time), do: GenServer.cast(pieces, {:appended, number, time})

  @doc "Closes what is open."
  @spec close(GenServer.server()) :: :ok
  def close(pieces), do: GenServer.stop(pieces, :normal, :timer.minutes(1))

  @impl true
  def init({name, root, opts, cut, keep, owner}) do
    Process.flag(:trap_exit, true)
    Process.monitor(owner)

    {:ok, %__MODULE__{name: name, root: root, opts: opts, cut: cut, keep: keep, owner: owner}}
  end

  @impl true
  def handle_call({:stream, number, name, opts}, _from, state) do
    number = max(number, oldest(state, number))

    with {:ok, state} <- opened(state, number),
         {:ok, stream, state} <- stream_of(state, number, name, opts) do
      {:reply, {:ok, number, stream}, retain(state)}
    else
      {:error, _} = error -> {:reply, error, state}
    end
  end

  @impl true
  def handle_cast({:appended, number, time}, %{cut: %{every: {:bytes, most}}} = state) do
    state = %{state | ended: Map.update(state.ended, number, time + 1, &max(&1, time + 1))}

    # Only the newest one grows into another; of those before it somebody is late.
    full? =
      not is_map_key(state.begun, number + 1) and is_map_key(state.open, number) and
        Writer.bytes(state.open[number]) >= most

    if full?, do: {:noreply, cut(state, number)}, else: {:noreply, state}
  end

  # Behind all streams, so that what is in a piece is earlier than the next.
  defp cut(state, number) do
    time = state.ended[number]
    :ok = Cut.cut(state.cut, time)
    put_in(state.begun[number + 1], time)
  end

  @impl true
  def handle_info({:DOWN, _, :process, owner, _}, %{owner: owner} = state),
    do: {:stop, :normal, state}

  def handle_info(_other, state), do: {:noreply, state}

  @impl true
  def terminate(_reason, state),
    do: Enum.each(state.open, fn {_, writer} -> Writer.close(writer) end)

  defp oldest(%{open: open}, number) when map_size(open) == 0, do: number
  defp oldest(%{open: open}, _number), do: open |> Map.keys() |> Enum.min()

  defp opened(%{open: open} = state, number) when is_map_key(open, number), do: {:ok, state}

  defp opened(state, number) do
    with {:ok, writer} <- Writer.create(state.name, state.root, state.opts),
         do: {:ok, %{state | open: Map.put(state.open, number, writer)}}
  end

  defp stream_of(%{streams: streams} = state, number, name, _opts)
       when is_map_key(streams, {number, name}),
       do: {:ok, streams[{number, name}], state}

  defp stream_of(state, number, name, opts) do
    with {:ok, stream} <- Writer.stream(state.open[number], name, opts),
         do: {:ok, stream, %{state | streams: Map.put(state.streams, {number, name}, stream)}}
  end

  # All but the two newest are closed, and the oldest of those closed deleted.
  defp retain(state) do
    done = state.open |> Map.keys() |> Enum.sort(:desc) |> Enum.drop(2)

    state =
      Enum.reduce(done, state, fn number, state ->
        {writer, open} = Map.pop(state.open, number)
        _ = Writer.close(writer)
        streams = Map.reject(state.streams, fn {{n, _}, _} -> n == number end)
        %{state | open: open, made: Map.put(state.made, number, writer.path), streams: streams}
      end)

    if done == [], do: state, else: delete(state, surplus(state.keep, state))
  end

  defp delete(state, numbers) do
    for number <- numbers, do: Folder.remove(state.made[number])
    %{state | made: Map.drop(state.made, numbers)}
  end

  defp surplus(nil, _state), do: []

  defp surplus({:span, span}, state) do
    newest = state.open |> Map.keys() |> Enum.max()

    for {number, _} <- state.made,
        begin(state, newest) - ending(state, number) >= span,
        do: number
  end

  # The open ones count, too: what is on the disk is to stay within the limit.
  defp surplus({:bytes, most}, state) do
    open = state.open |> Map.values() |> Enum.map(&size(&1.path)) |> Enum.sum()

    {surplus, _} =
      state.made
      |> Enum.sort(:desc)
      |> Enum.reduce({[], open}, fn {number, path}, {surplus, sum} ->
        sum = sum + size(path)
        {if(sum > most, do: [number | surplus], else: surplus), sum}
      end)

    surplus
  end

  defp begin(%{cut: %{every: every}}, number) when is_integer(every), do: number * every
  # The first one begins with its first message, before all others.
  defp begin(state, number), do: Map.get(state.begun, number, 0)

  defp ending(%{cut: %{every: every}}, number) when is_integer(every), do: (number + 1) * every
  defp ending(state, number), do: Map.get(state.ended, number, 0)

  defp size(path) do
    for file <- Path.wildcard(Path.join(path, "*.situ")), reduce: 0 do
      sum -> sum + File.stat!(file).size
    end
  end
end
