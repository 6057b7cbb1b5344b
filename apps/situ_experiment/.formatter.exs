[line_length: 98, inputs: ["{mix,.formatter}.exs", "{config,lib,test}/**/*.{ex,exs}"]]
