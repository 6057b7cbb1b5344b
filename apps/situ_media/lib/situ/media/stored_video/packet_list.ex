defmodule Situ.Media.StoredVideo.PacketList do
  @moduledoc false
  # Lists the packets of one stream of a recording for programs that decode them, such as the studio's page. A later
  # request continues where the last one ended, because the recording may be growing.
  use GenServer

  alias Situ.{Error, VideoPacket}
  alias Situ.Media.Recording.CodecName
  alias Situ.Recording.CodedVideo
  alias Situ.Store.Query

  @idle_ms 60_000

  defstruct [:source, :first, next: 0, count: 0, rows: []]

  @impl true
  def init(source), do: {:ok, %__MODULE__{source: source}, @idle_ms}

  @impl true
  def handle_call(:describe, _from, state) do
    case read_rows(state) do
      {:ok, state} -> {:reply, describe_video(state), state, @idle_ms}
      {:error, error} -> {:reply, {:error, error}, state, @idle_ms}
    end
  end

  @impl true
  def handle_info(:timeout, state), do: {:stop, :normal, state}
  def handle_info(_, state), do: {:noreply, state, @idle_ms}

  defp read_rows(%{source: %{store: store, info: info}} = state) do
    case Query.read_batch(store, info, state.next, :unbounded, 1_000, packets: true) do
      {:ok, [], _} ->
        {:ok, state}

      {:ok, messages, next} ->
        with :ok <- check_messages(info, messages) do
          rows = for message <- messages, into: <<>>, do: build_row(message)
          count = state.count + length(messages)
          first = state.first || hd(messages).data
          read_rows(%{state | rows: [state.rows, rows], next: next, count: count, first: first})
        end

      {:error, error} ->
        {:error, error}
    end
  end

  defp build_row(%{originating_time: time, data: packet}) do
    key = if VideoPacket.key?(packet), do: 1, else: 0
    <<time::signed-64, byte_size(packet.data)::32, key::8>>
  end

  defp check_messages(info, messages) do
    if Enum.all?(messages, &is_struct(&1.data, VideoPacket)),
      do: :ok,
      else: {:error, server_decodes(info, "some of its images are not stored as video")}
  end

  defp server_decodes(info, why) do
    Error.new(:not_coded, "the images of #{inspect(info.name)} can be decoded only on the server",
      why: why,
      fix: "record the stream with encode: :h264"
    )
  end

  defp describe_video(%{first: nil, source: %{info: info}}),
    do: {:error, server_decodes(info, "it has no images yet")}

  defp describe_video(%{first: packet, source: %{info: info}} = state) do
    case CodecName.translate("#{packet.codec}", packet.data, "Profile 0", "yuv420p") do
      {:ok, codec, _setup} ->
        {:ok,
         %CodedVideo{
           codec: codec,
           description: "",
           width: packet.width,
           height: packet.height,
           packets: IO.iodata_to_binary(state.rows)
         }}

      :error ->
        {:error, server_decodes(info, "its first packet is not a key frame")}
    end
  end
end
