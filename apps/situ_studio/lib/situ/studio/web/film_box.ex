defmodule Situ.Studio.Web.FilmBox do
  @moduledoc false
  # The film that a page makes of its pictures: begun from a panel's menu, its progress, the finished file.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Live.Socket
  alias Situ.Studio.Film.Job
  alias Situ.Studio.{Color, Film, Layout, WholeNumber}

  # An hour.
  @longest 3_600_000_000_000
  @over ["shapes"]

  @spec handle_event(String.t(), map(), Socket.t()) :: {:noreply, Socket.t()}
  # It takes the server's time: not for those who may only look.
  def handle_event("film_begin", _, %{assigns: %{viewer: true}} = socket),
    do: {:noreply, toast(socket, "You may look here, and not make films")}

  def handle_event("film_begin", params, %{assigns: assigns} = socket) do
    with {:ok, from} <- WholeNumber.parse(params["from"]),
         {:ok, to} when to > from and to - from <= @longest <- WholeNumber.parse(params["to"]),
         %{panel: :image} = panel <- Layout.panel(assigns.layout, params["panel"]),
         %Film{} = film <- film(panel, assigns, from, to) do
      {:noreply, begin(socket, film)}
    else
      _ -> {:noreply, toast(socket, "A film takes a panel with pictures, and an hour at most")}
    end
  end

  def handle_event("film_cancel", _, %{assigns: %{film: %{key: key}} = assigns} = socket) do
    Job.cancel(assigns.studio, key)
    {:noreply, assign(socket, film: nil)}
  end

  def handle_event(_, _, socket), do: {:noreply, socket}

  defp begin(%{assigns: assigns} = socket, film) do
    with %{key: key} <- assigns.film, do: Job.cancel(assigns.studio, key)
    {:ok, key} = Job.begin(assigns.studio, film, assigns.source)
    assign(socket, film: %{key: key, of: film, told: {:progress, 0.0}})
  end

  # The panel's layers: its picture, what is drawn over it, and the sound of the page.
  defp film(panel, assigns, from, to) do
    visible = Enum.reject(panel.vis, &(&1.props["visible"] == false))
    colors = Color.of(Enum.map(panel.vis, & &1.stream), assigns.colors)

    with %{} = picture <- Enum.find(visible, &(&1.viz == "image" and &1.path == "")) do
      over =
        for {v, color} <- Enum.zip(panel.vis, colors),
            v in visible and v.viz in @over and v.path == "",
            do: {v.stream, color}

      masks =
        for {v, color} <- Enum.zip(panel.vis, colors),
            v in visible and v.viz == "masks" and v.path == "",
            do: {v.stream, color, v.props}

      %Film{
        pictures: picture.stream,
        from: from,
        to: to,
        sound: sound(assigns),
        over: over,
        masks: masks,
        flip: picture.props["flip"] == true
      }
    end
  end

  # One that is shown, else the only one there is.
  defp sound(%{layout: layout, shapes: shapes}) do
    shown = for panel <- layout.rows, v <- panel.vis, shapes[v.stream] == :audio, do: v.stream
    all = for {name, :audio} <- shapes, do: name

    case {shown, all} do
      {[stream | _], _} -> stream
      {[], [stream]} -> stream
      _ -> nil
    end
  end

  @doc "How far the film is; of another one than the page's nothing."
  @spec told(Socket.t(), String.t(), term()) :: Socket.t()
  def told(%{assigns: %{film: %{key: key} = film}} = socket, key, told),
    do: assign(socket, film: %{film | told: told})

  def told(socket, _key, _told), do: socket

  attr(:film, :any, required: true)

  @doc false
  def box(%{film: film} = assigns) do
    assigns =
      assign(assigns,
        length: Situ.Time.format_duration(film.of.to - film.of.from),
        with: with_what(film.of),
        done: done(film.told),
        size: size(film.told),
        error: error(film.told)
      )

    ~H"""
    <section class="film" id="film" role="status" aria-label="Film">
      <b>Film of {@film.of.pictures}</b> <span class="hint">{@length}{@with}</span>
      <progress :if={@done} max="100" value={@done} aria-label="Progress of the film">{@done} %</progress>
      <span :if={@error} class="error" role="alert">{@error}</span>
      <a :if={@size} class="btn primary" id="film-file" href={"data/film?key=" <> @film.key}
          download="selection.mp4">Download ({@size} MB)</a>
      <button class="btn" type="button" phx-click="film_cancel">{if @done, do: "Cancel", else: "Close"}</button>
    </section>
    """
  end

  defp with_what(film) do
    case {film.sound != nil, film.over ++ film.masks != []} do
      {true, true} -> ", with sound and what is drawn over it"
      {true, false} -> ", with sound"
      {false, true} -> ", with what is drawn over it"
      _ -> ""
    end
  end

  defp done({:progress, part}), do: round(100 * part)
  defp done(_), do: nil
  defp size({:done, bytes}), do: :erlang.float_to_binary(bytes / 1.0e6, decimals: 2)
  defp size(_), do: nil
  defp error({:error, error}), do: Exception.message(error)
  defp error(_), do: nil

  defp toast(socket, text), do: push_event(socket, "toast", %{text: text})
end
