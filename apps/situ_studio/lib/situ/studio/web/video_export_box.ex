defmodule Situ.Studio.Web.VideoExportBox do
  @moduledoc false
  # Handles the export of a page's selection as a video or as an HTML page: it is started from a menu, then shown with
  # its progress and the finished file.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Live.Socket
  alias Situ.Studio.VideoExport.Job
  alias Situ.Studio.{Int64, Layout, PageExport, StreamColors, VideoExport}

  # The longest video is one hour.
  @longest 3_600_000_000_000
  @over ["shapes"]

  @spec handle_event(String.t(), map(), Socket.t()) :: {:noreply, Socket.t()}
  # Rendering uses the server's CPU, so view-only links cannot start it.
  def handle_event("film_begin", _, %{assigns: %{viewer: true}} = socket),
    do: {:noreply, show_toast(socket, "This link is view-only and cannot export videos")}

  def handle_event("film_page", _, %{assigns: %{viewer: true}} = socket),
    do: {:noreply, show_toast(socket, "This link is view-only and cannot export pages")}

  # The page has all panels of the layout.
  def handle_event("film_page", params, %{assigns: assigns} = socket) do
    with {:ok, from} <- Int64.parse(params["from"]),
         {:ok, to} when to > from <- Int64.parse(params["to"]) do
      {:noreply, start_job(socket, build_page(assigns, from, to))}
    else
      _ -> {:noreply, show_toast(socket, "Select a time first")}
    end
  end

  def handle_event("film_begin", params, %{assigns: assigns} = socket) do
    with {:ok, from} <- Int64.parse(params["from"]),
         {:ok, to} when to > from and to - from <= @longest <- Int64.parse(params["to"]),
         %{panel: :image} = panel <- Layout.find_panel(assigns.layout, params["panel"]),
         %VideoExport{} = film <- build_export(panel, assigns, from, to) do
      {:noreply, start_job(socket, film)}
    else
      _ ->
        {:noreply,
         show_toast(socket, "A video needs an image panel and can last at most one hour")}
    end
  end

  def handle_event("film_cancel", _, %{assigns: %{film: %{key: key}} = assigns} = socket) do
    Job.cancel(assigns.studio, key)
    {:noreply, assign(socket, film: nil)}
  end

  def handle_event(_, _, socket), do: {:noreply, socket}

  defp start_job(%{assigns: assigns} = socket, film) do
    with %{key: key} <- assigns.film, do: Job.cancel(assigns.studio, key)
    {:ok, key} = Job.start_job(assigns.studio, film, assigns.source)
    assign(socket, film: %{key: key, of: film, progress: {:progress, 0.0}})
  end

  defp build_page(assigns, from, to) do
    %PageExport{
      title: assigns.item.title,
      layout: assigns.layout,
      from: from,
      to: to,
      visualizers: assigns.extra
    }
  end

  # Combines the panel's image stream, its visible overlays, and an audio stream of the page.
  defp build_export(panel, assigns, from, to) do
    visible = Enum.reject(panel.vis, &(&1.props["visible"] == false))
    colors = StreamColors.assign_colors(Enum.map(panel.vis, & &1.stream), assigns.colors)

    with %{} = picture <- Enum.find(visible, &(&1.viz == "image" and &1.path == "")) do
      over =
        for {v, color} <- Enum.zip(panel.vis, colors),
            v in visible and v.viz in @over and v.path == "",
            do: {v.stream, color}

      masks =
        for {v, color} <- Enum.zip(panel.vis, colors),
            v in visible and v.viz == "masks" and v.path == "",
            do: {v.stream, color, v.props}

      %VideoExport{
        pictures: picture.stream,
        from: from,
        to: to,
        sound: find_audio_stream(assigns),
        over: over,
        masks: masks,
        flip: picture.props["flip"] == true
      }
    end
  end

  # Uses the first audio stream that is shown, or else the only one in the recording.
  defp find_audio_stream(%{layout: layout, shapes: shapes}) do
    shown = for panel <- layout.panels, v <- panel.vis, shapes[v.stream] == :audio, do: v.stream
    all = for {name, :audio} <- shapes, do: name

    case {shown, all} do
      {[stream | _], _} -> stream
      {[], [stream]} -> stream
      _ -> nil
    end
  end

  @doc "Updates the progress of the page's video; reports about other videos are ignored."
  @spec update_progress(Socket.t(), String.t(), term()) :: Socket.t()
  def update_progress(%{assigns: %{film: %{key: key} = film}} = socket, key, progress),
    do: assign(socket, film: %{film | progress: progress})

  def update_progress(socket, _key, _told), do: socket

  attr(:film, :any, required: true)

  @doc false
  def export_status(%{film: film} = assigns) do
    assigns =
      assign(assigns,
        title: export_title(film.of),
        kind: export_kind(film.of),
        ending: Job.file_ending(film.of),
        length: Situ.Time.format_duration(film.of.to - film.of.from),
        with: content_text(film.of),
        done: percent_done(film.progress),
        size: size_mb(film.progress),
        error: error_text(film.progress)
      )

    ~H"""
    <section class="film" id="film" role="status" aria-label={"Export of a " <> @kind}>
      <b>{@title}</b> <span class="hint">{@length}{@with}</span>
      <progress :if={@done} max="100" value={@done} aria-label={"Progress of the " <> @kind}>{@done} %</progress>
      <span :if={@error} class="error" role="alert">{@error}</span>
      <a :if={@size} class="btn primary" id="film-file" href={"data/film?key=" <> @film.key}
          download={"selection." <> @ending}>Download ({@size} MB)</a>
      <button class="btn" type="button" phx-click="film_cancel">{if @done, do: "Cancel", else: "Close"}</button>
    </section>
    """
  end

  defp export_title(%VideoExport{pictures: pictures}), do: "Video of " <> pictures
  defp export_title(%PageExport{title: title}), do: "HTML page of " <> title
  defp export_kind(%VideoExport{}), do: "video"
  defp export_kind(%PageExport{}), do: "page"

  defp content_text(%PageExport{}), do: ", opens without a server"

  defp content_text(film) do
    case {film.sound != nil, film.over ++ film.masks != []} do
      {true, true} -> ", with audio and overlays"
      {true, false} -> ", with audio"
      {false, true} -> ", with overlays"
      _ -> ""
    end
  end

  defp percent_done({:progress, part}), do: round(100 * part)
  defp percent_done(_), do: nil
  defp size_mb({:done, bytes}), do: :erlang.float_to_binary(bytes / 1.0e6, decimals: 2)
  defp size_mb(_), do: nil
  defp error_text({:error, error}), do: Exception.message(error)
  defp error_text(_), do: nil

  defp show_toast(socket, text), do: push_event(socket, "toast", %{text: text})
end
