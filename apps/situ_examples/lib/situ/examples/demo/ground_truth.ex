defmodule Situ.Examples.Demo.GroundTruth do
  @moduledoc """
  The ground truth of a clip: the positions of the faces, and who speaks when.

  It is read from JSON: `fps`, `frames`, `faces` (`id`, `box` as `[left, top, right, bottom]` in pixels) and `speech`
  (`face`, an id or `null` for a voice without a face; `speech_start` and `speech_end` in seconds; and `text` if the
  words are known). Other keys are ignored.

      iex> json = ~s({"fps": 25, "frames": 50, "faces": [{"id": 0, "box": [0, 0, 10, 10]}],
      ...>   "speech": [{"face": 0, "speech_start": 0.5, "speech_end": 1.5},
      ...>              {"face": null, "speech_start": 1.6, "speech_end": 1.9}]})
      iex> {:ok, truth} = Situ.Examples.Demo.GroundTruth.parse(json)
      iex> Situ.Examples.Demo.GroundTruth.speakers_at(truth, 1.0)
      [0]
      iex> Situ.Examples.Demo.GroundTruth.speakers_at(truth, 1.7)
      []
      iex> Situ.Examples.Demo.GroundTruth.near_edge?(truth, 1.45)
      true
  """
  alias Situ.{Error, Rect}

  @enforce_keys [:fps, :frames, :faces, :speech]
  defstruct [:fps, :frames, :faces, :speech, said: []]

  @type t :: %__MODULE__{
          fps: number(),
          frames: pos_integer(),
          faces: [{id :: term(), Rect.t()}],
          speech: [{face :: term() | nil, start_s :: number(), end_s :: number()}],
          said: [
            {face :: term() | nil, start_s :: number(), end_s :: number(), text :: String.t()}
          ]
        }

  # Human annotators disagree about the start and end of speech by about this much.
  @edge_s 0.2

  @doc "Reads the file at `path`."
  @spec read(Path.t()) :: {:ok, t()} | {:error, Error.t()}
  def read(path) do
    case File.read(path) do
      {:ok, json} ->
        with {:error, error} <- parse(json),
             do: {:error, %{error | what: "#{error.what} (#{path})"}}

      {:error, reason} ->
        {:error,
         Error.new(:no_truth, "cannot read the truth file: #{:file.format_error(reason)}",
           fix: "check the path #{path}"
         )}
    end
  end

  @doc "Parses a ground truth from JSON text."
  @spec parse(String.t()) :: {:ok, t()} | {:error, Error.t()}
  def parse(json) do
    with {:ok, %{"fps" => fps, "frames" => frames} = map}
         when is_number(fps) and fps > 0 and is_integer(frames) and frames > 0 <-
           decode_json(json),
         {:ok, faces} <- parse_all(map["faces"], &parse_face/1),
         {:ok, speech} <- parse_all(map["speech"], &parse_speech/1) do
      said =
        for %{"text" => text} = s when is_binary(text) <- map["speech"],
            {:ok, {f, a, b}} <- [parse_speech(s)],
            do: {f, a, b, text}

      {:ok, %__MODULE__{fps: fps, frames: frames, faces: faces, speech: speech, said: said}}
    else
      {:error, %Error{} = error} -> {:error, error}
      {:ok, _} -> invalid_truth("fps and frames must be numbers above 0")
    end
  end

  @doc "Returns the sorted ids of the faces that speak at `time_s` seconds."
  @spec speakers_at(t(), number()) :: [term()]
  def speakers_at(%__MODULE__{} = truth, time_s) do
    for({face, from, to} <- truth.speech, face != nil, time_s >= from, time_s < to, do: face)
    |> Enum.uniq()
    |> Enum.sort()
  end

  @doc "Returns whether `time_s` is within 0.2 s of the start or end of a speech segment."
  @spec near_edge?(t(), number()) :: boolean()
  def near_edge?(%__MODULE__{speech: speech}, time_s) do
    Enum.any?(speech, fn {_, from, to} ->
      abs(time_s - from) <= @edge_s or abs(time_s - to) <= @edge_s
    end)
  end

  @doc "Returns the id of the face whose box overlaps `rect` most, or `nil` if none does."
  @spec face_at(t(), Rect.t()) :: term() | nil
  def face_at(%__MODULE__{faces: faces}, rect) do
    {id, overlap} =
      faces
      |> Enum.map(fn {id, box} -> {id, Rect.iou(box, rect)} end)
      |> Enum.max_by(&elem(&1, 1), fn -> {nil, 0.0} end)

    if overlap > 0.0, do: id
  end

  defp decode_json(json) do
    with {:error, :bad_json} <- Situ.JSON.decode(json), do: invalid_truth("the file is not JSON")
  end

  defp parse_all(list, parse) when is_list(list) do
    Enum.reduce_while(list, {:ok, []}, fn item, {:ok, done} ->
      case parse.(item) do
        {:ok, parsed} -> {:cont, {:ok, [parsed | done]}}
        error -> {:halt, error}
      end
    end)
    |> then(fn result -> with {:ok, done} <- result, do: {:ok, Enum.reverse(done)} end)
  end

  defp parse_all(_, _parse), do: invalid_truth("faces and speech must be lists")

  defp parse_face(%{"id" => id, "box" => [x0, y0, x1, y1]})
       when is_number(x0) and is_number(y0) and is_number(x1) and is_number(y1) and x1 >= x0 and
              y1 >= y0,
       do: {:ok, {id, Rect.new!(x0, y0, x1 - x0, y1 - y0)}}

  defp parse_face(_), do: invalid_truth("a face needs an id and a box [left, top, right, bottom]")

  defp parse_speech(%{"speech_start" => from, "speech_end" => to} = s)
       when is_number(from) and is_number(to),
       do: {:ok, {s["face"], from, to}}

  defp parse_speech(_), do: invalid_truth("speech needs speech_start and speech_end in seconds")

  defp invalid_truth(why), do: {:error, Error.new(:bad_truth, "invalid truth file", why: why)}
end
