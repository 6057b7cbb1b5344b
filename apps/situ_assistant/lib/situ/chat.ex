defmodule Situ.Chat do
  @moduledoc """
  Asks a language model, using any local or remote service that implements OpenAI's protocol.

      answers = Situ.via([in: questions], Situ.Chat, model: "llama3.2", system: "Answer in one sentence.")
      answers.text |> Situ.each(&IO.write/1)

  Input `:in` is a user's text (a string), a `Situ.Chat.Turn` (with images), or a whole conversation (a list of turns).
  A message on `:cancel` ends the questions in flight: their connections are closed, and the text received so far
  becomes the answer.

  | output | content | time |
  |---|---|---|
  | `:text` | the answer in chunks, as they arrive | the question's time, one nanosecond later for each |
  | `:calls` | the model's tool calls, each when it is complete | likewise |
  | `:out` | the complete answer, `Situ.Chat.Answer` | the question's time |
  | `:failed` | a `Situ.Error`, with `failures: :emit` | the question's time |

  A tool call is a struct with the `id` of the call, the `name` of the tool, its `arguments` (a map with string keys,
  empty if they are not valid JSON), and `raw`, the arguments as the model wrote them.

  An answer has the time of its question, so it can be joined with other data of that time. The message's latency is
  the time that the answer took. While `concurrency` questions are in flight, the component accepts no more, and its
  producer waits.

  Programs without pipelines can call `ask/2`.

  ## Errors

  `:budget_spent`, `:too_many_calls` (the model calls tools in more than `rounds:` requests), `:chat_failed`,
  #{Situ.Infer.Service.describe_errors()}.
  """

  @own [
    system: [
      type: {:optional, :string},
      default: nil,
      doc: "Instructions for the model: the first turn of every conversation."
    ],
    remember: [
      type: :non_neg_integer,
      default: 8,
      doc:
        "How many previous questions and answers are sent to the model; used only if `concurrency` is 1."
    ],
    tools: [
      type: {:list, {:struct, Situ.Chat.Tool}},
      default: [],
      doc: "The tools the model may call, `Situ.Chat.Tool`."
    ],
    rounds: [
      type: :pos_integer,
      default: 5,
      doc: "The maximum number of requests for one question; each of them may call tools."
    ],
    concurrency: [
      type: :pos_integer,
      default: 1,
      doc: "How many questions are asked concurrently; answers keep the order of the questions."
    ],
    budget: [
      type: {:optional, :pos_integer},
      default: nil,
      doc:
        "How many tokens may be read and written in total; after that, questions fail with `:budget_spent`."
    ],
    failures: [
      type: {:in, [:raise, :emit]},
      default: :raise,
      doc:
        "How a failed question is reported: as an error of the component (see `on_error`) or as a message on `:failed`."
    ]
  ]
  @schema @own ++ Situ.Chat.Model.schema()

  use Situ.Component,
    inputs: [in: :any, cancel: {:any, optional: true}],
    outputs: [
      text: :string,
      calls: Situ.Chat.ToolCall,
      out: Situ.Chat.Answer,
      failed: Situ.Error
    ],
    options: @schema

  alias Situ.Chat.{Answer, History, Model, ToolLoop, Turn}
  alias Situ.Error

  defstruct [
    :opts,
    :model,
    :memory,
    jobs: [],
    tokens_used: 0,
    closing?: false,
    times: %{}
  ]

  @doc """
  Asks one question and waits for the answer. The options are those of the component; those that concern streams
  (`remember:`, `concurrency:`, `budget:`, `failures:`) have no effect.

      {:ok, answer} = Situ.Chat.ask("Who painted the Night Watch?", model: "llama3.2")
  """
  @spec ask(String.t() | Turn.t() | [Turn.t()], keyword()) ::
          {:ok, Answer.t()} | {:error, Error.t()}
  def ask(question, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, model} <- build_model(opts),
         {:ok, turns} <- History.parse_turns(question) do
      {pid, ref} =
        ToolLoop.start(
          self(),
          model,
          system_turns(opts[:system]) ++ turns,
          opts[:tools],
          opts[:rounds]
        )

      monitor = Process.monitor(pid)
      await_answer(ref, monitor)
    end
  end

  defp await_answer(ref, monitor) do
    receive do
      {:situ_chat, ^ref, {:done, result}} ->
        Process.demonitor(monitor, [:flush])
        result

      {:situ_chat, ^ref, _event} ->
        await_answer(ref, monitor)

      {:DOWN, ^monitor, _, _, reason} ->
        {:error, Error.new(:chat_failed, "the request process ended: #{inspect(reason)}")}
    end
  end

  defp build_model(opts), do: Model.new(Keyword.take(opts, Keyword.keys(Model.schema())))
  defp system_turns(nil), do: []
  defp system_turns(text), do: [Turn.system(text)]

  @impl true
  def init(opts) do
    with {:ok, model} <- build_model(opts) do
      capacity = if opts[:concurrency] == 1, do: opts[:remember], else: 0
      {:ok, %__MODULE__{opts: Map.new(opts), model: model, memory: History.new(capacity)}}
    end
  end

  @impl true
  def describe(state),
    do: "#{length(state.jobs)} questions in flight, #{state.tokens_used} tokens used"

  @impl true
  def handle_message(:in, %{data: question, originating_time: time}, _context, state) do
    turns = Error.unwrap!(History.parse_turns(question))
    state |> add_job(turns, time) |> hold_or_resume([])
  end

  def handle_message(:cancel, _message, _context, state) do
    jobs =
      for job <- state.jobs do
        if job.pid, do: Process.exit(job.pid, :kill)
        if job.result, do: job, else: %{job | pid: nil, result: {:ok, cancelled_answer(job)}}
      end

    emit_oldest(%{state | jobs: jobs}, [])
  end

  defp cancelled_answer(job),
    do: %Answer{
      text: IO.iodata_to_binary(job.text),
      finish: :cancelled,
      tokens: %{read: 0, written: job.count}
    }

  defp add_job(state, turns, time) do
    job = %{
      ref: make_ref(),
      pid: nil,
      time: time,
      turns: turns,
      text: [],
      count: 0,
      events: [],
      result: nil
    }

    start_job(%{state | jobs: state.jobs ++ [job]}, job)
  end

  defp start_job(%{opts: %{budget: budget}, tokens_used: tokens_used} = state, job)
       when is_integer(budget) and tokens_used >= budget do
    error =
      Error.new(
        :budget_spent,
        "#{tokens_used} of #{budget} tokens are used; no more requests are sent",
        fix: "raise budget:"
      )

    send(self(), {:situ_chat, job.ref, {:done, {:error, error}}})
    state
  end

  defp start_job(state, job) do
    turns = system_turns(state.opts.system) ++ History.with_history(state.memory, job.turns)
    {pid, ref} = ToolLoop.start(self(), state.model, turns, state.opts.tools, state.opts.rounds)
    replace_job(state, %{job | pid: pid}, ref)
  end

  defp replace_job(state, %{ref: old} = job, ref) do
    jobs = Enum.map(state.jobs, &if(&1.ref == old, do: %{job | ref: ref}, else: &1))
    %{state | jobs: jobs}
  end

  @impl true
  def handle_info({:situ_chat, ref, event}, _context, state),
    do: state |> update_job(ref, event) |> emit_oldest([])

  def handle_info({:hold_ended, :in}, _context, state), do: hold_or_resume(state, [])

  # The input is closed, so the component waits for the questions in flight, one event at a time.
  def handle_info({:continue, :wait}, _context, %{jobs: []} = state), do: {[], state}

  def handle_info({:continue, :wait}, _context, state) do
    receive do
      {:situ_chat, ref, event} -> state |> update_job(ref, event) |> emit_oldest([])
    after
      # Returns regularly so that the pipeline's own messages are handled.
      20 -> {[{:continue, :wait}], state}
    end
  end

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_closed(:in, _time, _context, state), do: emit_oldest(%{state | closing?: true}, [])
  def handle_closed(:cancel, _time, _context, state), do: {[], state}

  @impl true
  def terminate(_reason, state) do
    for %{pid: pid} when is_pid(pid) <- state.jobs, do: Process.exit(pid, :kill)
    :ok
  end

  defp update_job(state, ref, event) do
    jobs =
      for job <- state.jobs,
          do: if(job.ref == ref and job.result == nil, do: add_job_event(job, event), else: job)

    %{state | jobs: jobs}
  end

  defp add_job_event(job, {:done, result}), do: %{job | result: result, pid: nil}

  defp add_job_event(job, {:text, text} = e),
    do: %{job | text: [job.text, text], count: job.count + 1, events: [e | job.events]}

  defp add_job_event(job, {:call, _} = event), do: %{job | events: [event | job.events]}

  # Only the oldest question emits; events of the others are kept until it has ended.
  defp emit_oldest(%{jobs: []} = state, actions), do: hold_or_resume(state, actions)

  defp emit_oldest(%{jobs: [job | rest]} = state, actions) do
    {actions, state} = emit_events(Enum.reverse(job.events), job.time, actions, state)

    case job.result do
      nil -> hold_or_resume(%{state | jobs: [%{job | events: []} | rest]}, actions)
      {:ok, answer} -> emit_answer(%{state | jobs: rest}, job, answer, actions)
      {:error, error} -> emit_failure(%{state | jobs: rest}, job, error, actions)
    end
  end

  defp emit_events(events, time, actions, state) do
    Enum.reduce(events, {actions, state}, fn {kind, data}, {actions, state} ->
      output = if kind == :call, do: :calls, else: :text
      at = max(time, Map.get(state.times, output, time - 1) + 1)
      {[{output, at, data} | actions], %{state | times: Map.put(state.times, output, at)}}
    end)
  end

  defp emit_answer(state, job, answer, actions) do
    tokens_used = state.tokens_used + answer.tokens.read + answer.tokens.written
    memory = History.add_exchange(state.memory, job.turns, answer)

    emit_oldest(%{state | tokens_used: tokens_used, memory: memory}, [
      {:out, job.time, answer} | actions
    ])
  end

  defp emit_failure(%{opts: %{failures: :emit}} = state, job, error, actions),
    do: emit_oldest(state, [{:failed, job.time, error} | actions])

  defp emit_failure(state, job, error, actions) do
    meta = Map.put(error.meta, :originating_time, job.time)
    emit_oldest(state, [{:error, %{error | meta: meta}} | actions])
  end

  # At the limit, the input is held so that its producer waits.
  defp hold_or_resume(%{closing?: true, jobs: jobs} = state, actions) do
    waiting = if jobs != [], do: [{:continue, :wait}], else: []
    {Enum.reverse(actions) ++ waiting, state}
  end

  defp hold_or_resume(%{jobs: jobs, opts: %{concurrency: most}} = state, actions) do
    action = if length(jobs) >= most, do: {:hold, :in}, else: {:resume, :in}
    {Enum.reverse([action | actions]), state}
  end
end
