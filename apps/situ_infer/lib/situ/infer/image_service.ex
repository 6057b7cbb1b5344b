defmodule Situ.Infer.ImageService do
  @moduledoc """
  Describes images with a service that has Azure's interface (Image Analysis 4.0). For services with OpenAI's interface,
  send an image to `Situ.Chat` (`Situ.Chat.Turn.user/2`).

      seen = Situ.via(pictures, Situ.Infer.ImageService, url: "https://my.cognitiveservices.azure.com")
      Situ.each(seen, fn seen -> IO.inspect(for {tag, p} <- seen.tags, p > 0.8, do: tag) end)

  Input `:in` is images (`Situ.Image`, or `Situ.EncodedImage`, which is sent unchanged). Output `:out` is a map for each
  image, at its time: `caption: {text, confidence} | nil`, `tags: [{name, confidence}]`, and `objects:`, `people:` and
  `text:` as lists of `Situ.Rect` in image pixels with label and score. Images wait while the service processes one, so
  use a policy such as `Situ.Delivery.latest()` for a camera.

  ## Errors

  `:bad_answer`, #{Situ.Infer.Service.describe_errors()}.
  """

  @own [
    url: [
      type: :string,
      required: true,
      doc: "The endpoint of the resource: `https://NAME.cognitiveservices.azure.com`."
    ],
    features: [
      type: {:list, {:in, [:caption, :tags, :objects, :people, :text]}},
      default: [:tags, :objects],
      doc: "The results to request."
    ],
    quality: [type: {:integer, 1, 100}, default: 85, doc: "The quality of the uploaded JPEG."]
  ]
  @schema @own ++ Situ.Infer.Service.schema("AZURE_VISION_KEY")

  use Situ.Component, inputs: [in: :any], outputs: [out: :map], options: @schema

  alias Situ.{EncodedImage, Error, Image, ImageOps, Rect}
  alias Situ.Infer.Service

  @names %{caption: "caption", tags: "tags", objects: "objects", people: "people", text: "read"}
  @path "/computervision/imageanalysis:analyze?"

  @type seen :: %{
          caption: {String.t(), float()} | nil,
          tags: [{String.t(), float()}],
          objects: [Rect.t()],
          people: [Rect.t()],
          text: [Rect.t()]
        }

  @impl true
  def init(opts) do
    with {:ok, service} <- Service.new(opts[:url], opts, "ocp-apim-subscription-key") do
      features = Enum.map_join(opts[:features], ",", &@names[&1])
      query = URI.encode_query("api-version": "2024-02-01", features: features)
      {:ok, %{service: service, path: @path <> query, quality: round(opts[:quality])}}
    end
  end

  @impl true
  def handle_message(:in, %{data: picture, originating_time: time}, _context, state),
    do: {[{:out, time, Error.unwrap!(analyze_image(state, picture))}], state}

  defp analyze_image(state, picture) do
    with {:ok, bytes} <- encode_image(picture, state.quality),
         headers = [{"content-type", "application/octet-stream"}],
         {:ok, body} <- Service.post(state.service, state.path, headers, bytes) do
      case Situ.JSON.decode(body) do
        {:ok, %{} = json} -> {:ok, parse_result(json)}
        _ -> {:error, Service.bad_answer()}
      end
    end
  end

  defp encode_image(%EncodedImage{data: data}, _quality), do: {:ok, data}

  defp encode_image(%Image{} = image, quality) do
    with {:ok, %EncodedImage{data: data}} <- ImageOps.encode_jpeg(image, quality: quality),
         do: {:ok, data}
  end

  defp encode_image(other, _quality),
    do: {:error, Error.new(:bad_image, "not an image: #{inspect(other, limit: 3)}")}

  @doc "Parses the service's JSON response; values that are missing or malformed are left out."
  @spec parse_result(map()) :: seen()
  def parse_result(json) do
    %{
      caption: parse_caption(json["captionResult"]),
      tags:
        for(
          %{"name" => name, "confidence" => p} <- result_values(json["tagsResult"]),
          is_binary(name),
          do: {name, clamp_score(p)}
        ),
      objects:
        for(
          %{"boundingBox" => box, "tags" => [%{"name" => name, "confidence" => p} | _]} <-
            result_values(json["objectsResult"]),
          rect <- build_rect(box, name, p),
          do: rect
        ),
      people:
        for(
          %{"boundingBox" => box, "confidence" => p} <- result_values(json["peopleResult"]),
          rect <- build_rect(box, "person", p),
          do: rect
        ),
      text: parse_lines(json["readResult"])
    }
  end

  defp parse_caption(%{"text" => text, "confidence" => p}) when is_binary(text),
    do: {text, clamp_score(p)}

  defp parse_caption(_), do: nil

  defp result_values(%{"values" => values}) when is_list(values), do: values
  defp result_values(_), do: []

  defp parse_lines(%{"blocks" => blocks}) when is_list(blocks) do
    for %{"lines" => lines} when is_list(lines) <- blocks,
        %{"text" => text, "boundingPolygon" => [_ | _] = polygon} <- lines,
        points =
          for(%{"x" => x, "y" => y} when is_number(x) and is_number(y) <- polygon, do: {x, y}),
        points != [],
        {{left, right}, {top, bottom}} = {axis_bounds(points, 0), axis_bounds(points, 1)},
        rect <-
          build_rect(
            %{"x" => left, "y" => top, "w" => right - left, "h" => bottom - top},
            text,
            1.0
          ),
        do: rect
  end

  defp parse_lines(_), do: []

  defp axis_bounds(points, i), do: points |> Enum.map(&elem(&1, i)) |> Enum.min_max()

  defp build_rect(%{"x" => x, "y" => y, "w" => w, "h" => h}, label, p) when is_binary(label) do
    case Rect.new(x: x, y: y, width: w, height: h, label: label, score: clamp_score(p)) do
      {:ok, rect} -> [rect]
      {:error, _} -> []
    end
  end

  defp build_rect(_box, _label, _p), do: []

  defp clamp_score(p) when is_number(p), do: p |> max(0) |> min(1) |> Kernel./(1)
  defp clamp_score(_), do: 0.0
end
