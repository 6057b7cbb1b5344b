defmodule Situ.Studio.Web.Dataset.SessionSearch do
  @moduledoc false
  # The dialog that finds the times in all sessions of a dataset where an expression is true. A task searches one
  # session after the other, and the page shows its results as they arrive. A click on a time opens the session there.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2]
  alias Situ.Dataset.OpenSession
  alias Situ.Live.Socket
  alias Situ.{Query, Time}
  alias Situ.Studio.Datasets.DatasetRef
  alias Situ.Studio.Web.{Dataset.Rows, Paths}

  @timeout_ms 60_000
  @most 1_000
  @listed 100

  @type search :: %{
          text: String.t(),
          least: String.t(),
          run: {reference(), pid()} | nil,
          done: non_neg_integer(),
          total: non_neg_integer(),
          results: [{String.t(), {:ok, Query.result()} | {:error, Situ.Error.t()}}],
          error: String.t() | nil
        }

  @doc "Returns a dialog without results."
  @spec new_search() :: search()
  def new_search,
    do: %{text: "", least: "", run: nil, done: 0, total: 0, results: [], error: nil}

  @spec handle_event(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_event("find_open", _, socket), do: assign(socket, dialog: {:search, new_search()})

  def handle_event(
        "find_run",
        %{"text" => text, "least" => least},
        %{assigns: %{dialog: {:search, search}}} = socket
      )
      when is_binary(text) and is_binary(least) do
    search =
      stop_search(%{
        search
        | text: String.slice(text, 0, 1_000),
          least: String.slice(least, 0, 20)
      })

    with {:ok, expression} <- Situ.Expression.parse(search.text),
         {:ok, least} <- parse_least(search.least) do
      sessions =
        Rows.matching_sessions(socket.assigns.dataset, socket.assigns.facts, socket.assigns.query)

      search = %{search | error: nil, results: [], done: 0, total: length(sessions)}
      assign(socket, dialog: {:search, start_search(search, sessions, {expression, least})})
    else
      {:error, error} ->
        assign(socket, dialog: {:search, %{search | error: Exception.message(error), results: []}})
    end
  end

  def handle_event("find_stop", _, %{assigns: %{dialog: {:search, search}}} = socket),
    do: assign(socket, dialog: {:search, stop_search(search)})

  def handle_event(_, _, socket), do: socket

  defp parse_least(text) do
    case String.trim(text) do
      "" -> {:ok, 0}
      text -> with :error <- Time.parse_duration(text), do: {:error, duration_error(text)}
    end
  end

  defp duration_error(text) do
    Situ.Error.new(:bad_option, "#{inspect(text)} is not a duration",
      fix: "write it with a unit, such as 3s or 200ms"
    )
  end

  defp start_search(search, sessions, {expression, least}) do
    page = self()
    run = make_ref()

    {:ok, pid} =
      Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
        # the search ends with the page
        for session <- sessions, Process.alive?(page) do
          options = [least: least, limit: @most, timeout: @timeout_ms]
          result = session |> OpenSession.open() |> Query.run(expression, options)
          send(page, {:session_found, run, session.name, result})
        end
      end)

    %{search | run: {run, pid}}
  end

  @doc "Ends the task of a search; results so far stay."
  @spec stop_search(search()) :: search()
  def stop_search(%{run: {_, pid}} = search) do
    _ = Task.Supervisor.terminate_child(Situ.Studio.Tasks, pid)
    %{search | run: nil}
  end

  def stop_search(search), do: search

  @doc "Ends the search of a dialog that is closed."
  @spec close_dialog(term()) :: :ok
  def close_dialog({:search, search}) do
    _ = stop_search(search)
    :ok
  end

  def close_dialog(_dialog), do: :ok

  @doc "Adds the result of a session, if it belongs to the latest search."
  @spec put_result(Socket.t(), reference(), {String.t(), term()}) :: Socket.t()
  def put_result(
        %{assigns: %{dialog: {:search, %{run: {run, _}} = search}}} = socket,
        run,
        result
      ) do
    done = search.done + 1
    run = if done < search.total, do: search.run
    search = %{search | results: search.results ++ [result], done: done, run: run}
    assign(socket, dialog: {:search, search})
  end

  def put_result(socket, _run, _result), do: socket

  attr(:search, :map, required: true)
  attr(:id, :string, required: true)

  @doc false
  def dialog(assigns) do
    ~H"""
    <dialog id="session-search" class="task" phx-hook="Modal" aria-label="Find times in all sessions">
      <h3>Find the times where</h3>
      <form id="session-search-form" phx-submit="find_run">
        <textarea name="text" rows="2" aria-label="Expression" spellcheck="false" autofocus
            placeholder="'Ada' in Speech">{@search.text}</textarea>
        <label>at least <input name="least" value={@search.least} placeholder="3s" size="6" autocomplete="off"
            aria-label="Minimum duration"></label>
        <div class="choices">
          <button class="btn primary" type="submit">Find</button>
          <button :if={@search.run} class="btn" type="button" phx-click="find_stop">Stop</button>
          <button class="btn" type="button" phx-click="dialog_close">Close</button>
        </div>
      </form>
      <p :if={@search.error} class="error" role="alert">{@search.error}</p>
      <p :if={@search.total > 0} class="hint" role="status">{status_text(@search)}</p>
      <div class="found-times">
        <section :for={{session, result} <- shown_results(@search.results)} :key={session}>
          <h4>{session} <small>{result_text(result)}</small></h4>
          <a :for={{from, to} <- hits(result)} class="hit"
              href={hit_path(@id, session, {from, to})}><b>{format_clock(from)}</b>
            <span>{Time.format_duration(to - from)}</span></a>
        </section>
      </div>
    </dialog>
    """
  end

  defp status_text(search) do
    times = for {_, {:ok, found}} <- search.results, do: length(found.intervals)

    found =
      "#{count(Enum.sum(times), "time")} in #{count(Enum.count(times, &(&1 > 0)), "session")}"

    if search.run, do: "#{found}; #{search.done} of #{search.total} searched", else: found
  end

  defp count(1, noun), do: "1 #{noun}"
  defp count(n, noun), do: "#{n} #{noun}s"

  # Sessions without times are counted, not listed.
  defp shown_results(results), do: Enum.reject(results, &match?({_, {:ok, %{intervals: []}}}, &1))

  defp hits({:ok, found}), do: Enum.take(found.intervals, @listed)
  defp hits({:error, _}), do: []

  defp result_text({:error, error}), do: error.what

  defp result_text({:ok, %{intervals: intervals} = found}) do
    more =
      if found.truncated? or length(intervals) > @listed, do: ", the first #{@listed} are listed"

    "#{length(intervals)}#{more}"
  end

  defp format_clock(time), do: time |> Time.to_iso8601() |> String.slice(11, 12)

  # The session opens with the time selected, in the middle of the view.
  defp hit_path(dataset, session, {from, to}) do
    around = max(to - from, 2_000_000_000)
    view = "#{from - around}~#{to + around}"
    query = URI.encode_query(%{"at" => from, "sel" => "#{from}~#{to}", "view" => view})
    Paths.source_path(DatasetRef.build_id(dataset, [session])) <> "?" <> query
  end
end
