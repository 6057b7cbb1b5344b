defmodule Situ.Studio.Web.QueryPanel do
  @moduledoc false
  # Handles the panel "Find the times where": its input field, the intervals found, and the actions on them.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]
  import Situ.Studio.Web.Icons

  alias Situ.Live.Socket
  alias Situ.Studio.{Annotations, IntervalSearch, Int64}
  alias Situ.Studio.Web.AnnotationPanel

  # At most this many intervals are listed, but all of them become annotations.
  @listed 200

  @doc "Returns whether the item has recordings on disk that can be searched."
  @spec available?(map()) :: boolean()
  def available?(%{item: item}), do: IntervalSearch.searchable_parts(item) != []
  def available?(_), do: false

  @spec handle_event(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_event("query_open", _, socket) do
    if available?(socket.assigns),
      do: assign(socket, query_panel: socket.assigns.query_panel || new_panel()),
      else: show_toast(socket, "Only recordings on disk can be searched")
  end

  def handle_event("query_close", _, socket), do: assign(socket, query_panel: nil)

  def handle_event(
        "query_run",
        %{"text" => text},
        %{assigns: %{query_panel: %{} = panel}} = socket
      )
      when is_binary(text) do
    text = String.slice(text, 0, 1_000)
    parts = IntervalSearch.searchable_parts(socket.assigns.item)
    page = self()
    run = make_ref()

    # A task runs the query, so the page stays responsive. The result of an earlier query is dropped.
    Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
      send(page, {:found, run, IntervalSearch.run_query(parts, text)})
    end)

    assign(socket, query_panel: %{panel | text: text, run: run, found: nil, error: nil})
  end

  def handle_event("query_go", %{"from" => from, "to" => to}, socket) do
    with {:ok, _} <- Int64.parse(from), {:ok, _} <- Int64.parse(to) do
      push_event(socket, "select_times", %{from: from, to: to})
    else
      :error -> socket
    end
  end

  def handle_event(
        "query_annotate",
        _,
        %{assigns: %{query_panel: %{found: %{}} = panel}} = socket
      ) do
    %{studio: studio, item: item} = socket.assigns
    {:ok, schema} = Annotations.parse_schema("Query", "")

    with true <- AnnotationPanel.available?(socket.assigns) or {:error, not_annotatable_error()},
         {:ok, editor} <- Annotations.Layers.open_editor(studio, item, "Query", schema),
         found = Enum.map(panel.found.intervals, &build_proposal(&1, panel.text)),
         {:ok, _} <- Annotations.add_proposals(editor, found, "query") do
      AnnotationPanel.open_layer(socket, "Query", nil)
    else
      {:error, error} -> show_toast(socket, Exception.message(error))
    end
  end

  def handle_event(_, _, socket), do: socket

  defp build_proposal({from, to}, text),
    do: %{from: from, to: to, lane: text, label: "", confidence: nil}

  defp not_annotatable_error do
    Situ.Error.new(
      :not_annotated,
      "only a recording on disk or a session of a dataset file (.json) can be annotated, in a studio that is not " <>
        "read-only"
    )
  end

  @doc "Shows the intervals found, if they belong to the latest query."
  @spec put_result(Socket.t(), reference(), term()) :: Socket.t()
  def put_result(%{assigns: %{query_panel: %{run: run} = panel}} = socket, run, {:ok, found}),
    do: assign(socket, query_panel: %{panel | found: found, run: nil})

  def put_result(%{assigns: %{query_panel: %{run: run} = panel}} = socket, run, {:error, error}),
    do: assign(socket, query_panel: %{panel | error: Exception.message(error), run: nil})

  def put_result(socket, _run, _result), do: socket

  defp new_panel, do: %{text: "", run: nil, found: nil, error: nil}
  defp show_toast(socket, text), do: push_event(socket, "toast", %{text: text})

  attr(:panel, :map, required: true)
  attr(:from, :integer, required: true)
  attr(:annotate, :boolean, required: true)

  @doc false
  def search_panel(assigns) do
    ~H"""
    <section class="query" aria-label="Find times">
      <div class="side-title">Find the times where<button class="mini" type="button" phx-click="query_close"
          aria-label="Close"><.icon name={:close} /></button></div>
      <form id="query" phx-submit="query_run">
        <textarea id="query-text" phx-hook="Enter" name="text" rows="3" aria-label="Expression" spellcheck="false"
            placeholder="`Mic.Level` > 0.5 and `Vad.Speaking`">{@panel.text}</textarea>
        <div class="choices">
          <button class="btn primary" type="submit">Find</button>
          <button :if={@annotate and @panel.found != nil and @panel.found.intervals != []} class="btn" type="button"
              phx-click="query_annotate">As annotations</button>
        </div>
      </form>
      <p :if={@panel.run} class="hint" role="status">Searching ...</p>
      <p :if={@panel.error} class="error" role="alert">{@panel.error}</p>
      <p :if={@panel.found} class="hint" role="status">{result_text(@panel.found)}</p>
      <div :if={@panel.found} class="found-times">
        <button :for={{from, to} <- Enum.take(@panel.found.intervals, max_listed())} type="button" phx-click="query_go"
            phx-value-from={from} phx-value-to={to}><b>{format_offset(from - @from)}</b>
          <span>{Situ.Time.format_duration(to - from)}</span></button>
      </div>
    </section>
    """
  end

  defp max_listed, do: @listed

  defp result_text(%{intervals: []}), do: "No times found"

  defp result_text(%{intervals: intervals} = found) do
    total = intervals |> Enum.map(fn {from, to} -> to - from end) |> Enum.sum()
    more = if found.truncated?, do: " and more", else: ""
    times = if length(intervals) == 1, do: "1 time", else: "#{length(intervals)} times"
    "#{times}#{more}, #{Situ.Time.format_duration(total)} in total"
  end

  # Formats a time relative to the start of the data, like the ruler does.
  defp format_offset(ns) do
    seconds = div(ns, 1_000_000_000)
    ms = div(rem(ns, 1_000_000_000), 1_000_000)
    pad = &String.pad_leading(Integer.to_string(&1), &2, "0")
    "#{div(seconds, 60)}:#{pad.(rem(seconds, 60), 2)}.#{pad.(ms, 3)}"
  end
end
