defmodule Situ.ImageStream.OperatorExamples do
  @moduledoc false
  # The examples of the operators that `Situ.ImageStream` generates from its tables. Its tests run them.

  # Each has the image, the operator, an expression, and its value.
  @examples %{
    resize: {"Situ.Image.new_filled(4, 2, :gray8, 7)", "resize(2, 1)", "result.data", "<<7, 7>>"},
    scale:
      {"Situ.Image.new_filled(4, 2, :gray8)", "scale(0.5, 2)", "{result.width, result.height}",
       "{2, 4}"},
    letterbox:
      {"Situ.Image.new_filled(4, 2, :gray8, 9)", "letterbox(4, 4)", "result.data",
       "<<0, 0, 0, 0, 9, 9, 9, 9, 9, 9, 9, 9, 0, 0, 0, 0>>"},
    rotate:
      {"Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<1, 2, 3>>)", "rotate(90)",
       "{result.width, result.height}", "{1, 3}"},
    warp_affine:
      {"Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<1, 2, 3>>)",
       "warp_affine([1, 0, 1, 0, 1, 0])", "result.data", "<<0, 1, 2>>"},
    warp_perspective:
      {"Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<1, 2, 3>>)",
       "warp_perspective([1, 0, 1, 0, 1, 0, 0, 0, 1])", "result.data", "<<0, 1, 2>>"},
    paste:
      {"Situ.Image.new_filled(3, 1, :gray8)",
       "paste(Situ.Image.new_filled(1, 1, :gray8, 9), {2, 0})", "result.data", "<<0, 0, 9>>"},
    threshold:
      {"Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<10, 50, 90>>)",
       "threshold(40, :binary)", "result.data", "<<0, 255, 255>>"},
    pseudo_colorize:
      {"Situ.DepthImage.new!(width: 1, height: 1, data: <<1500::little-16>>)",
       "pseudo_colorize({0.5, 2.5})", "{result.format, result.width}", "{:bgra32, 1}"},
    blur:
      {"Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 90, 0, 0>>)",
       "blur(1.0)", "result.data", "<<10, 22, 36, 22, 10>>"},
    draw_line:
      {"Situ.Image.new_filled(3, 1, :gray8)", "draw_line({0, 0}, {1, 0}, color: 9)",
       "result.data", "<<9, 9, 0>>"},
    draw_rectangle:
      {"Situ.Image.new_filled(3, 3, :gray8)", "draw_rectangle({0, 0, 3, 3}, color: 9)",
       "result.data", "<<9, 9, 9, 9, 0, 9, 9, 9, 9>>"},
    fill_rectangle:
      {"Situ.Image.new_filled(3, 1, :gray8)", "fill_rectangle({1, 0, 2, 1}, color: 9)",
       "result.data", "<<0, 9, 9>>"},
    draw_circle:
      {"Situ.Image.new_filled(5, 5, :gray8)", "draw_circle({2, 2}, 2, color: 90)",
       "Situ.Image.fetch_pixel(result, 2, 0)", "{:ok, [90]}"},
    fill_circle:
      {"Situ.Image.new_filled(5, 5, :gray8)", "fill_circle({2, 2}, 2, color: 90)",
       "Situ.Image.fetch_pixel(result, 2, 2)", "{:ok, [90]}"},
    draw_text:
      {"Situ.Image.new_filled(20, 12, :gray8)", ~S|draw_text({1, 1}, "hi", size: 8)|,
       "result == image", "false"},
    statistics:
      {"Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<10, 50, 90>>)",
       "statistics()", "result.gray",
       "%{deviation: 32.659863237109036, max: 90, mean: 50.0, min: 10}"},
    average_color:
      {"Situ.Image.new_filled(2, 2, :bgr24, :red)", "average_color()", "result",
       "%{blue: 0.0, green: 0.0, red: 255.0}"},
    histogram:
      {"Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<0, 2, 2>>)", "histogram()",
       "Enum.take(result.gray, 4)", "[1, 0, 2, 0]"},
    encode_jpeg:
      {"Situ.Image.new_filled(4, 2, :bgr24)", "encode_jpeg(quality: 80)",
       "{result.format, result.width, result.height}", "{:jpeg, 4, 2}"},
    encode_png:
      {"Situ.Image.new_filled(4, 2, :bgr24)", "encode_png()",
       "{result.format, result.width, result.height}", "{:png, 4, 2}"},
    decode_depth:
      {"Situ.DepthImage.new!(width: 1, height: 1, data: <<1500::little-16>>)",
       "encode_png() |> Situ.ImageStream.decode_depth()", "result == image", "true"},
    flip:
      {"Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<1, 2, 3>>)",
       "flip(:vertical)", "result.data", "<<3, 2, 1>>"},
    convert:
      {"Situ.Image.new_filled(1, 1, :bgr24, [1, 2, 3])", "convert(:rgb24)", "result.data",
       "<<3, 2, 1>>"},
    invert:
      {"Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<0, 55, 255>>)", "invert()",
       "result.data", "<<255, 200, 0>>"},
    extract_channel:
      {"Situ.Image.new_filled(2, 1, :bgr24, [1, 2, 3])", "extract_channel(:red)", "result.data",
       "<<3, 3>>"},
    convolve:
      {"Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<10, 20, 40>>)",
       "convolve([[1, 1, 1]])", "result.data", "<<15, 23, 30>>"},
    box_blur:
      {"Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 90, 0, 0>>)",
       "box_blur(3)", "result.data", "<<0, 30, 30, 30, 0>>"},
    median_blur:
      {"Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<5, 5, 90, 5, 5>>)",
       "median_blur(3)", "result.data", "<<5, 5, 5, 5, 5>>"},
    canny:
      {"Situ.ImageOps.fill_rectangle!(Situ.Image.new_filled(8, 8, :gray8), {4, 0, 4, 8}, color: 200)",
       "canny(60, 120)",
       "result |> Situ.ImageOps.crop!({0, 4, 8, 1}) |> Situ.Image.pixel_bytes()",
       "<<0, 0, 0, 255, 0, 0, 0, 0>>"},
    sobel:
      {"Situ.ImageOps.fill_rectangle!(Situ.Image.new_filled(8, 8, :gray8), {4, 0, 4, 8}, color: 200)",
       "sobel()", "result |> Situ.ImageOps.crop!({0, 4, 8, 1}) |> Situ.Image.pixel_bytes()",
       "<<0, 0, 0, 128, 128, 0, 0, 0>>"},
    erode:
      {"Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 9, 9, 9, 0>>)",
       "erode(3)", "result.data", "<<0, 0, 9, 0, 0>>"},
    dilate:
      {"Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 9, 0, 0>>)",
       "dilate(3)", "result.data", "<<0, 9, 9, 9, 0>>"},
    open:
      {"Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 9, 0, 0>>)", "open(3)",
       "result.data", "<<0, 0, 0, 0, 0>>"},
    close:
      {"Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<9, 9, 0, 9, 9>>)",
       "close(3)", "result.data", "<<9, 9, 9, 9, 9>>"},
    equalize:
      {"Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<10, 20, 30>>)", "equalize()",
       "result.data", "<<0, 128, 255>>"},
    draw:
      {"Situ.Image.new_filled(3, 1, :gray8)", "draw([{:line, {0, 0}, {1, 0}, color: 9}])",
       "result.data", "<<9, 9, 0>>"}
  }

  @doc "Returns the doctest of an operator."
  @spec format_example(atom()) :: String.t()
  def format_example(name) do
    {image, call, read, result} = Map.fetch!(@examples, name)

    """
        iex> image = #{image}
        iex> [result] = Situ.to_list(fn p ->
        ...>   p |> Situ.repeat(image, every: 10, count: 1) |> Situ.ImageStream.#{call}
        ...> end)
        iex> #{read}
        #{result}
    """
  end
end
