defmodule Situ.Studio.Web.DerivedStreams do
  @moduledoc false
  # Loads the derived streams of a page, which its layout uses or which were created on the page.
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Error
  alias Situ.Live.Socket
  alias Situ.Studio.{MemberExpressions, StreamInfo, StreamReader}
  alias Situ.Studio.Recordings.DerivedStreams

  @most 64
  # The members are taken from a sample of this many messages, because keys of a map may come and go.
  @looked_at 200

  @doc "Returns facts about the derived streams. Streams whose input streams the recording lacks are left out."
  @spec list_infos(map()) :: [StreamInfo.t()]
  def list_infos(assigns) do
    for "= " <> text <- derived_names(assigns),
        {:ok, info} <- [DerivedStreams.derive_stream(assigns.source, text)],
        do: info
  end

  defp derived_names(assigns) do
    shown = for panel <- layout_rows(assigns[:layout]), vis <- panel.vis, do: vis.stream

    (assigns.derived ++ shown)
    |> Enum.filter(&DerivedStreams.derived_name?/1)
    |> Enum.uniq()
    |> Enum.take(@most)
  end

  defp layout_rows(nil), do: []
  defp layout_rows(layout), do: layout.panels

  @doc "Reloads the streams if the layout has derived streams that are not loaded yet."
  @spec ensure_loaded(Socket.t(), (Socket.t() -> Socket.t())) :: Socket.t()
  def ensure_loaded(%{assigns: %{shapes: shapes} = assigns} = socket, load) do
    if Enum.all?(derived_names(assigns), &is_map_key(shapes, &1)), do: socket, else: load.(socket)
  end

  def ensure_loaded(socket, _load), do: socket

  @doc "Adds a derived stream to the page and returns its name."
  @spec add_stream(Socket.t(), String.t()) :: {:ok, String.t(), Socket.t()} | {:error, Error.t()}
  def add_stream(%{assigns: assigns} = socket, text) do
    with {:ok, info} <- DerivedStreams.derive_stream(assigns.source, String.slice(text, 0, 1_000)) do
      derived = Enum.take(Enum.uniq([info.name | assigns.derived]), @most)
      {:ok, info.name, assign(socket, derived: derived)}
    end
  end

  @doc "Adds a derived stream for each member of a stream's values and shows how many were added."
  @spec derive_members(Socket.t(), String.t(), (Socket.t() -> Socket.t())) :: Socket.t()
  def derive_members(socket, stream, load) do
    case add_members(socket, stream) do
      {:ok, n, socket} ->
        text = if n == 1, do: "1 derived stream", else: "#{n} derived streams"
        socket |> load.() |> push_event("toast", %{text: text <> " added at the top of the tree"})

      {:error, error} ->
        push_event(socket, "toast", %{text: Exception.message(error)})
    end
  end

  defp add_members(%{assigns: assigns} = socket, stream) do
    with %StreamInfo{} = info <-
           Enum.find(assigns.infos, &(&1.name == stream)) || no_stream_error(stream),
         [_ | _] = texts <-
           MemberExpressions.member_expressions(stream, sample_values(assigns.source, info)) do
      names =
        for text <- texts,
            {:ok, info} <- [DerivedStreams.derive_stream(assigns.source, text)],
            do: info.name

      derived = Enum.take(Enum.uniq(names ++ assigns.derived), @most)
      {:ok, length(names), assign(socket, derived: derived)}
    else
      [] -> {:error, Error.new(:no_members, "the values of #{stream} have no members")}
      error -> error
    end
  end

  defp no_stream_error(stream), do: {:error, Error.new(:no_stream, "unknown stream: #{stream}")}

  defp sample_values(_source, %{first: nil}), do: []

  defp sample_values(source, %{name: name, first: first, last: last}) do
    case StreamReader.sample_messages(source, name, first, last, @looked_at) do
      {:ok, sample} -> for {_, message} <- sample, do: message.data
      {:error, _} -> []
    end
  end
end
