defmodule Situ.Metric do
  @moduledoc """
  Metrics of an experiment: they compare a stream of a pipeline with the truth, or measure the run.

      def metrics do
        [
          speaking: Situ.Metric.intervals(truth: "Speaking.Truth", tolerance: Situ.Time.ms(200)),
          words: Situ.Metric.transcript(truth: "Words.Truth"),
          cost: Situ.Metric.cost(),
          openings: fn measured -> Enum.count(Situ.Metric.messages(measured, "Mouths")) end
        ]
      end

  | metric | compares | values, the main one first |
  |---|---|---|
  | `intervals/1` | booleans, maps of booleans, annotations | `f1`, `precision`, `recall`, `onset_error_s`, `offset_error_s`, `time_f1`, `time_precision`, `time_recall` |
  | `classes/1` | labels, maps of labels, annotations | `kappa`, `accuracy`, `macro_f1` |
  | `regression/1` | numbers | `mae`, `rmse`, `r2`, `missing` |
  | `detections/1` | boxes in images | `map`, `recall` |
  | `tracks/1` | maps from ids to boxes | `mota`, `idf1`, `switches` |
  | `transcript/1` | texts | `wer` |
  | `speaker_transcript/1` | who said what: annotations, maps from speakers to texts | `cpwer`, `tcpwer` |
  | `latency/1` | creation time minus originating time | `p95_s`, `p50_s`, `max_s` |
  | `cost/0` | the pipeline's components | `busy_s_per_s` |
  | a function | anything: it returns a number, or a map of numbers | `value`, or the names in the map |

  `truth:` is a stream of the session, and `stream:` is a stream that `build/3` returns. A truth `"Speaking.Truth"` is
  compared with `"Speaking"` by default. `main:` chooses the value that tables, searches and comparisons use.

  Counts of sessions are added before a value is computed, so a session with many events weighs more than one with few.
  The mean absolute error, for example, is a mean over all messages. The values of `latency/1`, `cost/0` and functions
  are means over sessions. A value that would divide by zero is `nil`, such as the precision without any output.

  ## Your own metric

  A function receives a `measured` map: `session` (a `Situ.Dataset.OpenSession`), `output` (the recording of the streams
  of `build/3`), `span` (the first and the last time of the session, ns), `parameters` and `busy_s`. Higher values are
  better, unless `function/2` says otherwise.
  """
  alias Situ.Dataset.OpenSession
  alias Situ.{Error, Options, Store}

  alias Situ.Metric.{
    ClassScore,
    DetectionScore,
    IntervalScore,
    MeanScore,
    RegressionScore,
    SpeakerWordScore,
    TrackScore,
    WordScore
  }

  @enforce_keys [:kind, :score, :main]
  defstruct [:kind, :score, :main, :fun, better: %{}, options: []]

  @type t :: %__MODULE__{
          kind: atom(),
          score: module(),
          main: String.t(),
          fun: (map() -> number() | map() | nil) | nil,
          better: %{String.t() => :higher | :lower},
          options: keyword()
        }
  @typedoc "The argument of a metric that is a function."
  @type measured :: %{
          session: OpenSession.t(),
          output: Store.t(),
          span: {Situ.Time.t(), Situ.Time.t()},
          parameters: map(),
          busy_s: float()
        }

  @streams [
    truth: [type: :string, required: true, doc: "The stream of the session with the true values."],
    stream: [
      type: :string,
      doc: "The stream to compare. Default: the truth's name without `.Truth`."
    ],
    main: [type: {:or, [:atom, :string]}, doc: "The value that tables and searches use."]
  ]
  @near [
    tolerance: [
      type: :time_ns,
      default: 0,
      doc: "The largest distance between the times of a true message and of its counterpart."
    ]
  ]
  @intervals @streams ++
               [
                 tolerance: [
                   type: :time_ns,
                   default: 200_000_000,
                   doc: "The largest error of a boundary."
                 ],
                 match: [
                   type: {:in, [:boundaries, :onset, :overlap]},
                   default: :boundaries,
                   doc:
                     "Which intervals are the same event: those with the same boundaries or the same start, within " <>
                       "the tolerance, or any that overlap."
                 ]
               ]
  @classes @streams ++
             [
               frame: [
                 type: :pos_integer,
                 default: 10_000_000,
                 doc: "Time (ns) between the instants at which labels are compared."
               ]
             ]
  @overlap [
    overlap: [
      type: {:range, 0, 1},
      default: 0.5,
      doc: "The least overlap (intersection over union) of two boxes that are the same object."
    ]
  ]
  @detections @streams ++ @near ++ @overlap
  @transcript @streams ++
                [
                  normalize: [
                    type: :boolean,
                    default: true,
                    doc: "Ignore case and punctuation."
                  ]
                ]

  @speaker_transcript @transcript ++
                        [
                          collar: [
                            type: :time_ns,
                            default: 5_000_000_000,
                            doc:
                              "`tcpwer`: the largest distance between a true word and its counterpart."
                          ]
                        ]

  @doc """
  Compares intervals, such as who speaks when, on each track.

  Intervals are matched one to one. `precision`, `recall` and `f1` count matched intervals, `onset_error_s` and
  `offset_error_s` are the mean distances of their boundaries, and `time_*` compare the time that is covered.

  #{Options.docs(@intervals)}
  """
  @spec intervals(keyword()) :: t()
  def intervals(opts), do: build_metric(:intervals, IntervalScore, "f1", opts, @intervals)

  @doc """
  Compares labels over frames of equal length: Cohen's `kappa`, `accuracy`, and the mean F1 over the labels
  (`macro_f1`).

  #{Options.docs(@classes)}
  """
  @spec classes(keyword()) :: t()
  def classes(opts), do: build_metric(:classes, ClassScore, "kappa", opts, @classes)

  @doc """
  Compares numbers: mean absolute error, root mean square error, coefficient of determination, and the share of true
  values without a value of the stream (`missing`).

  #{Options.docs(@streams ++ @near)}
  """
  @spec regression(keyword()) :: t()
  def regression(opts),
    do: build_metric(:regression, RegressionScore, "mae", opts, @streams ++ @near)

  @doc """
  Compares boxes in images: mean average precision over the labels as in COCO, at one overlap. A message is a list of
  `Situ.Rect`, or of structs with `rect`, and `label` and `score` if they have them.

  #{Options.docs(@detections)}
  """
  @spec detections(keyword()) :: t()
  def detections(opts), do: build_metric(:detections, DetectionScore, "map", opts, @detections)

  @doc """
  Compares tracked boxes: MOTA, IDF1 and the number of switches of identity. A message is a map from ids to boxes, or a
  list of structs with `id` and `rect`.

  #{Options.docs(@detections)}
  """
  @spec tracks(keyword()) :: t()
  def tracks(opts), do: build_metric(:tracks, TrackScore, "mota", opts, @detections)

  @doc """
  Compares texts: the word error rate. The texts of all messages of a session are joined, in order.

  #{Options.docs(@transcript)}
  """
  @spec transcript(keyword()) :: t()
  def transcript(opts), do: build_metric(:transcript, WordScore, "wer", opts, @transcript)

  @doc """
  Compares who said what: the word error rate when the words of each speaker are joined, and each speaker of the output
  is compared with the true speaker that gives the least errors (`cpwer`). The names of the speakers need not agree.
  `tcpwer` also counts words at the wrong time as errors.

  A message is a list of annotations with the speaker as their track, or a map from speakers to texts.

  #{Options.docs(@speaker_transcript)}
  """
  @spec speaker_transcript(keyword()) :: t()
  def speaker_transcript(opts),
    do: build_metric(:speaker_transcript, SpeakerWordScore, "cpwer", opts, @speaker_transcript)

  @doc """
  Measures how long after its originating time each message of `stream:` was created; by default, each message of all
  streams that `build/3` returns. This needs a replay in real time: an experiment with this metric defines `settings/0`
  as `[speed: 1.0]`.
  """
  @spec latency(keyword()) :: t()
  def latency(opts \\ []) do
    opts =
      Options.validate!(opts,
        stream: [type: {:optional, :string}, default: nil],
        main: [type: {:or, [:atom, :string]}, default: "p95_s"]
      )

    better = %{"p50_s" => :lower, "p95_s" => :lower, "max_s" => :lower}
    main = to_string(opts[:main])
    %__MODULE__{kind: :latency, score: MeanScore, main: main, better: better, options: opts}
  end

  @doc """
  Measures the computing time: the seconds that the components were busy, per second of data. Cached stages count with
  the time that they took when they were computed.
  """
  @spec cost() :: t()
  def cost do
    better = %{"busy_s_per_s" => :lower}
    %__MODULE__{kind: :cost, score: MeanScore, main: "busy_s_per_s", better: better}
  end

  @doc """
  Makes a metric of a function. Options: `better:`, `:higher` (default) or `:lower`; `main:`, if it returns a map.

      iex> metric = Situ.Metric.function(fn measured -> measured.busy_s end, better: :lower)
      iex> {metric.main, Situ.Metric.direction(metric, "value")}
      {"value", :lower}
  """
  @spec function((measured() -> number() | map() | nil), keyword()) :: t()
  def function(fun, opts \\ []) when is_function(fun, 1) do
    %__MODULE__{
      kind: :function,
      score: MeanScore,
      fun: fun,
      main: to_string(opts[:main] || "value"),
      options: [better: opts[:better] || :higher]
    }
  end

  defp build_metric(kind, score, main, opts, schema) do
    opts = Options.validate!(opts, schema)
    stream = opts[:stream] || String.replace_suffix(opts[:truth], ".Truth", "")
    main = to_string(opts[:main] || main)
    names = Map.keys(score.directions())

    if main not in names do
      raise ArgumentError,
            "metric #{kind} has no value #{inspect(main)}: use one of #{Enum.join(names, ", ")}"
    end

    opts = Keyword.put(opts, :stream, stream)
    %__MODULE__{kind: kind, score: score, main: main, better: score.directions(), options: opts}
  end

  @doc "Returns whether higher or lower numbers of a value are better."
  @spec direction(t(), String.t()) :: :higher | :lower
  def direction(%__MODULE__{} = metric, value),
    do: Map.get(metric.better, value, metric.options[:better] || :higher)

  @doc """
  Returns the values of measurements, one for each session, as `%{name => number | nil}`. Returns no values without
  measurements.

      iex> metric = Situ.Metric.transcript(truth: "Words.Truth")
      iex> Situ.Metric.summarize(metric, [%{"words" => 3, "errors" => 1}, %{"words" => 5, "errors" => 1}])
      %{"wer" => 0.25}
  """
  @spec summarize(t(), [map()]) :: %{String.t() => number() | nil}
  def summarize(%__MODULE__{}, []), do: %{}

  def summarize(%__MODULE__{score: score}, measurements),
    do: score |> Situ.Metric.Measure.merge_all(measurements) |> score.compute_values()

  @doc "Returns the messages of a stream of the output or, if it has no such stream, of the session."
  @spec messages(measured(), String.t()) :: Enumerable.t()
  def messages(measured, stream) do
    if Store.has_stream?(measured.output, stream),
      do: Store.messages(measured.output, stream),
      else: measured.session |> OpenSession.messages(stream) |> Error.unwrap!()
  end
end
